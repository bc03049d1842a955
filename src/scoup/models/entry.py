"""Rows of the tables of models."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup.base import Entry
from scoup.models.hub import ModelIdentity, is_cached

Encode = Callable[[list[str]], Tensor]
"""Phrases to vectors [Q, D]."""
Texts = tuple[Encode, ModelIdentity]
"""The text half of an embedder, and what its vectors depend on."""
Device = torch.device | str
DENSE_PREFIX = "dense:"  # before the model in the name of an embedder that is run densely
_HUB_ID = re.compile(r"[\w.-]+/[\w.-]+")


@dataclass(frozen=True)
class ModelEntry(Entry):
    """A segmenter or an embedder."""

    open: Callable[..., Any]
    """Takes name, revision and device; a segmenter also takes ``MaskSettings``.
    Returns an object with the methods of ``scoup.extract.interfaces``."""
    texts: Callable[[str, str | None, Device], Texts] | None = None
    """Takes name, revision and device, and returns the text half of an embedder; None if it has none."""
    size: str = ""
    """Of the weights in 32 bits."""
    seconds: float | None = None
    """Of a CPU per photograph: docs/benchmarks/extract.json (preset fast), embed.json; None if not measured."""
    file: tuple[str, str] | None = None
    """Hub id, and the file of the weights; None where the user names the weights."""

    def model_id(self, name: str) -> str:
        """Return the hub id that a name of this entry is short for, or else the name."""
        return name if self.file is None else self.file[0]

    def is_recorded(self, name: str, recorded: object) -> bool:
        """Return whether a manifest's ``recorded`` model, which it names by its hub id, is that of a name."""
        return recorded in (name, name.removeprefix(DENSE_PREFIX), self.model_id(name))

    def cells(self) -> dict[str, str]:
        """Return column -> text."""
        # "-": the user names the weights, or there are none.
        weights = "-" if self.file is None else "here" if is_cached(*self.file) else "not here"
        return {
            "name": self.name,
            "size": self.size or "-",
            "licence": self.licence or "-",
            "CPU seconds": "-" if self.seconds is None else f"{self.seconds:.1f}",
            "needs": f"scoup[{self.extra}]" if self.extra else "-",
            "weights": weights,
            "what it is": self.help,
        }


@dataclass(frozen=True)
class HubEntry(ModelEntry):
    """Any model by its folder, file or hub id."""

    def answers_to(self, name: str) -> bool:
        return bool(_HUB_ID.fullmatch(name)) or name.endswith((".pt", ".pth")) or Path(name).exists()
