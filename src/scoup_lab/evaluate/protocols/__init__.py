"""The protocols of published data sets, one module each."""
