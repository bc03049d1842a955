"""The base of all rooms: errors, progress, processes, whole files, the compiled core, Triton."""
