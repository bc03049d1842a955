"""Splat files, one module a format."""
