"""Queries to a language field: where, which pixels, which Gaussians, and whether at all."""
