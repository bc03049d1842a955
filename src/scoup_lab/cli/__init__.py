"""The verbs of the laboratory: ``scoup demo``, ``scoup eval``."""
