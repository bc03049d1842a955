"""Every system that is compared, ours included, as a method: they share the rasteriser, the regions and the queries."""
