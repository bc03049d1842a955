# Stops the build when an object of the kernels holds what one instruction set might hand to another, or what
# runs before the instruction set is chosen:
#
#     cmake -DNM=nm "-DOBJECTS=a.o;b.o" -P check_kernel_objects.cmake
#
# Symbols of vague linkage (types W, V and u of nm) are merged by the linker, which keeps the copy it meets
# first: perhaps one that the CPU at hand cannot run. Initialisers (_GLOBAL__sub_I_...) run when the module is
# loaded. DW.ref.__gxx_personality_v0 is a pointer, the same in every copy.

foreach(object IN LISTS OBJECTS)
  execute_process(COMMAND ${NM} ${object} OUTPUT_VARIABLE listing COMMAND_ERROR_IS_FATAL ANY)
  string(REGEX MATCHALL "[0-9a-f]+ ([WVu] [^\n]+|t _GLOBAL__sub_I[^\n]*)" symbols "${listing}")
  list(FILTER symbols EXCLUDE REGEX " DW\\.ref\\.")
  if(symbols)
    list(TRANSFORM symbols REPLACE "^[0-9a-f]+ . " "")
    list(JOIN symbols ", " symbols)
    message(FATAL_ERROR
      "${object} must define nothing outside its own namespace, but has: ${symbols} (see isa.h)")
  endif()
endforeach()
