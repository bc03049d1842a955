"""A field in the browser: the data of its page, the server, and pages that need none (docs/viewer.md)."""
