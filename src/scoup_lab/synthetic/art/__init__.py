"""Content of synthetic scenes: meshes, paints, light, things made of them, and the layout of the demo (``table``)."""
