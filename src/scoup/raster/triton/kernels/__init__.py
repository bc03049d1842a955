"""Triton kernels of the rasteriser on a GPU, launched by ``scoup.raster.triton.rendering`` and its neighbours."""
