"""Splat files, one module per format."""
