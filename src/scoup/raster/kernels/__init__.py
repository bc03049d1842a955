"""Triton kernels of the rasteriser on a GPU, launched by ``scoup.raster.gpu`` and its neighbours."""
