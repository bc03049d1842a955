"""Verbs by name."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Family:
    """Verbs by name, or families of verbs.

    Attributes:
        description: for the help; its first paragraph for lists.
        verbs: where each is, "module:name" of a dataclass or of a further family; imported when it is used.
        others: where a function from any other name to a verb, or None, is; "" if there are no others.
    """

    description: str
    verbs: Mapping[str, str]
    others: str = ""

    def load(self, name: str) -> type | Family:
        """Import a verb, or a family of verbs."""
        return _imported(self.verbs[name])

    def find(self, name: str) -> type | Family | None:
        """Return the verb or family of a name; None if there is none."""
        if name in self.verbs:
            return self.load(name)
        return _imported(self.others)(name) if self.others and name[:1].isalnum() else None


def _imported(target: str) -> Any:
    module, _, attribute = target.partition(":")
    return getattr(importlib.import_module(module), attribute)
