"""Camera files, one module per format."""
