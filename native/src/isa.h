// Which instruction set the kernels use.
//
// Files named *_kernels.cpp are compiled once for each instruction set, with SCOUP_ISA naming a namespace of their
// own. They must not define anything with vague linkage (std templates, inline functions outside an unnamed
// namespace): the linker keeps one copy of those, which might be the one the CPU at hand cannot run.
#pragma once

namespace scoup {

enum class Isa { baseline, v3, v4 };  // baseline: x86-64-v2, or what the compiler takes for granted elsewhere

const char* name_of(Isa isa);

// The set in use: the best this CPU runs, until use_isa says otherwise.
Isa current_isa();

// Makes later calls use the set of that name ("baseline", "v3", "v4", or "best"). False, and no change, if there is
// none of that name or the CPU lacks it.
bool use_isa(const char* name);

// The table of kernels for the set in use.
template <class Table>
const Table& pick(const Table& baseline, const Table& v3, const Table& v4) {
    switch (current_isa()) {
        case Isa::v4: return v4;
        case Isa::v3: return v3;
        default: return baseline;
    }
}

// Declares `const type name` in the namespace of each instruction set.
#if defined(SCOUP_X86)
#define SCOUP_KERNEL_TABLE(type, name)             \
    namespace baseline { extern const type name; } \
    namespace v3 { extern const type name; }       \
    namespace v4 { extern const type name; }
#else
#define SCOUP_KERNEL_TABLE(type, name)             \
    namespace baseline { extern const type name; } \
    namespace v3 { using baseline::name; }         \
    namespace v4 { using baseline::name; }
#endif

}  // namespace scoup
