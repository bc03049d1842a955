"""Fields served: to people as a page in the browser (docs/viewer.md), to language models as tools (docs/agents.md)."""
