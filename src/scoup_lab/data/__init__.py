"""Labels of published data sets, as their files have them, and models of COLMAP, written."""
