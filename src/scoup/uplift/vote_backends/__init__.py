"""The vote, a backend a module; the reference is the specification."""
