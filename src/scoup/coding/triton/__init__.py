"""Coding for GPUs, in Triton."""
