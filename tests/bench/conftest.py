"""Tests of what lies in benchmarks/ import it from the checkout."""

from __future__ import annotations
