"""The language field: its data, its file, and relevancy."""
