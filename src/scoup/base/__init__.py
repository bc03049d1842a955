"""What every room rests on: errors, progress, processes, whole files, the compiled core, Triton."""
