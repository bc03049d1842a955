"""Scores against ground truth: one file a protocol, plus metrics."""
