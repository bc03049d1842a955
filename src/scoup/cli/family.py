"""Verbs by name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Family:
    """Verbs by name, or families of verbs.

    Attributes:
        description: for the help; its first paragraph for lists.
        verbs: where each is, "module:name" of a dataclass or of a further family; imported when it is used.
    """

    description: str
    verbs: Mapping[str, str]

    def load(self, name: str) -> type | Family:
        """Import a verb, or a family of verbs."""
        module, _, attribute = self.verbs[name].partition(":")
        return getattr(importlib.import_module(module), attribute)
