"""Folders of region features, one module a layout."""
