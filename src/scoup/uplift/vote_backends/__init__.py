"""Backends of the vote, one per module; ``reference`` is the specification."""
