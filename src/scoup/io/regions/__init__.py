"""Folders of region features, one module per layout."""
