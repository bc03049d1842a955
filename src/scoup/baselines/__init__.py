"""What a sparse field is compared with; each shares the rasteriser and the queries of the method itself."""
