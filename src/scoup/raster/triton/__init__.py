"""The rasteriser for GPUs, in Triton."""
