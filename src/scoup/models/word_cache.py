"""Vectors of everyday words in the user's cache, so that each model encodes them once.

A file is a word table (.npz) with the probe and the words; its name contains a digest of the words and the model.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import astuple
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base import FileFormatError, ScoupError, slug, write_npz
from scoup.models.hub import ModelIdentity
from scoup.models.word_table import MODEL_KEY, WordTable

PROBE = "object"
"""A phrase whose vector shows whether a file came from this model."""
_VERSION = 1  # of how vectors are made and kept
_LEAST_COSINE = 1 - 1e-5  # of the probe with itself; other devices and versions round differently


def everyday_vectors(
    model: ModelIdentity, probe: Tensor, words: Sequence[str], encode: Callable[[Sequence[str]], Tensor]
) -> Tensor:
    """Return unit vectors of words [B, D] float32: those in the cache, else encoded and written there.

    Both are rounded to 16 bits, so they are the same. A file that is damaged or of another model is replaced, and a
    cache that cannot be written is not used. ``probe`` [1, D] is the model's vector of ``PROBE``; ``encode`` returns
    vectors of unit norm.
    """
    path, names = _file(model, words), (PROBE, *words)
    if path is not None and (known := _read(path, names, probe)) is not None:
        return known
    vectors = torch.cat([probe, encode(words)])
    arrays = {"names": np.array(names), "vectors": vectors.half().numpy(), MODEL_KEY: np.array(model.name)}
    try:
        table = WordTable(path or Path(), names, arrays["vectors"], model.name)
    except FileFormatError:
        return vectors[1:]  # a damaged model: not finite
    if path is not None:
        with suppress(ScoupError, OSError):
            write_npz(path, arrays, overwrite=True)
    return torch.from_numpy(table.vectors[1:])


def cache_folder() -> Path | None:
    """Return the folder of SCOUP's cache, which may be missing; None if the user has no home.

    It is the environment variable ``SCOUP_CACHE``, else ``scoup`` in the usual place of the platform: $XDG_CACHE_HOME
    or ~/.cache, ~/Library/Caches on macOS, %LOCALAPPDATA% on Windows.
    """
    if configured := os.environ.get("SCOUP_CACHE"):
        return Path(configured)
    variable, usual = {
        "darwin": ("", "Library/Caches"),
        "win32": ("LOCALAPPDATA", "AppData/Local"),
    }.get(sys.platform, ("XDG_CACHE_HOME", ".cache"))
    base = os.environ.get(variable, "")
    if os.path.isabs(base):  # XDG: a relative path is ignored
        return Path(base) / "scoup"
    try:
        return Path.home() / usual / "scoup"
    except RuntimeError:
        return None


def _file(model: ModelIdentity, words: Sequence[str]) -> Path | None:
    folder = cache_folder()
    if folder is None:
        return None
    digest = hashlib.sha256(json.dumps([_VERSION, PROBE, astuple(model), words]).encode())
    name = slug(f"{model.name} {model.revision}")
    return folder / "words" / f"{name}-{digest.hexdigest()[:16]}.npz"


def _read(path: Path, names: Sequence[str], probe: Tensor) -> Tensor | None:
    """Return the vectors of all names but the first; None unless the file is whole and of this model."""
    try:
        table = WordTable.load(path)
    except (ScoupError, OSError):
        return None
    if table.names != tuple(names) or table.vectors.shape[1:] != probe.shape[1:]:
        return None
    vectors = torch.from_numpy(table.vectors)
    return vectors[1:] if float(vectors[0].double() @ probe[0].double()) >= _LEAST_COSINE else None
