"""Content of synthetic scenes: things with meshes and paints, light, and the layout of the demo (``table``)."""
