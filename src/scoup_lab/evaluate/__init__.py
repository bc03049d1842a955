"""Scores against ground truth: one file per protocol, plus metrics."""
