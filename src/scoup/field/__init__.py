"""The language field: its codes, their file, and what it renders."""
