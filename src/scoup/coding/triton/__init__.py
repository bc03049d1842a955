"""The exact coder for GPUs, in Triton."""
