"""Vectors of everyday and of asked words in the user's cache, so that each model encodes them once.

A file is a word table (.npz) with the probe and the words, all everyday ones or one asked; its name contains a digest
of the words and the model. A further file per model says which one its name has opened.
"""

from __future__ import annotations

import hashlib
import json
import os
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import astuple
from functools import cached_property
from pathlib import Path
from threading import Lock
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base import FileFormatError, ScoupError, slug, write_npz
from scoup.models.entry import Device
from scoup.models.failures import reason_of
from scoup.models.hub import ModelIdentity
from scoup.models.word_table import MODEL_KEY, WordTable
from scoup.models.words import EVERYDAY_WORDS

PROBE = "object"
"""A phrase whose vector shows whether a file came from this model."""
MOST_ALONE = 64  # phrases to encode one by one, and to keep
_VERSION = 2  # of how vectors are made and kept
_MOST_BYTES = 60  # of a kept phrase: no more tokens than models read, which would warn of it each time
_MOST_FILES = 4096  # of asked words
_LEAST_COSINE = 1 - 1e-5  # of the probe with itself; other devices and versions round differently
EncodeUnit = Callable[[Sequence[str]], Tensor]
"""Phrases to unit vectors [Q, D] float32 on the CPU."""


class CachedTexts:
    """A text model that is opened at the first phrase that the user's cache lacks.

    A vector depends on the other phrases only in that many at once are encoded together: not on what is cached.
    ``load`` opens the model; its encoder returns vectors of unit norm.
    """

    def __init__(
        self,
        name: str,
        revision: str | None,
        device: Device,
        load: Callable[[], tuple[EncodeUnit, ModelIdentity]],
    ) -> None:
        self.name, self._load, self._lock = name, load, Lock()
        self._folder = f"asked/{torch.device(device).type}"  # others round differently
        self._key = [_VERSION, name, revision, self._folder]
        self._path = _path(self._folder, name, self._key)
        self._encode: EncodeUnit | None = None
        known = None if self._path is None else _read_model(self._path, self._key)
        if known is None or not known[0].is_current(name, revision):
            known, self._encode = self._opened()
        self.model, self.probe = known

    def encode(self, phrases: Sequence[str]) -> Tensor:
        """Return [Q, D] float32 unit vectors of one phrase or more."""
        rows = {word: row for row, word in enumerate(EVERYDAY_WORDS)}
        others = list(dict.fromkeys(phrase for phrase in phrases if phrase not in rows))
        vectors = map(self._one, others) if len(others) <= MOST_ALONE else self._new(others)
        new = dict(zip(others, vectors, strict=True))
        return torch.stack(
            [new[phrase] if phrase in new else self.everyday[rows[phrase]] for phrase in phrases]
        )

    @cached_property
    def everyday(self) -> Tensor:
        """Unit vectors of the everyday words, [B, D] float32."""
        return cached_vectors(self.model, self.probe, EVERYDAY_WORDS, self._new)

    def _one(self, phrase: str) -> Tensor:
        if len(phrase.encode("utf-8", "surrogatepass")) > _MOST_BYTES:
            return self._new([phrase])[0]
        return cached_vectors(self.model, self.probe, [phrase], self._new, self._folder)[0]

    def _new(self, phrases: Sequence[str]) -> Tensor:
        with self._lock:
            if self._encode is None:
                (model, probe), encode = self._opened()
                if model != self.model or not _alike(probe, self.probe):
                    raise ScoupError(f"{self.name}: has changed since its words were cached; open it again")
                self._encode = encode
        return self._encode(phrases)

    def _opened(self) -> tuple[tuple[ModelIdentity, Tensor], EncodeUnit]:
        """Open the model, and write its identity and vector of the probe to the cache."""
        encode, model = self._load()
        try:
            probe = encode([PROBE])
        except (ValueError, TypeError, LookupError) as error:  # of a damaged tokenizer
            reason = reason_of(self.name, error)
            raise ScoupError(f"text model {self.name!r} encodes no words: {reason}") from error
        if self._path is not None:
            record = json.dumps([self._key, astuple(model)])
            arrays = {"names": np.array([PROBE]), "vectors": probe.numpy(), MODEL_KEY: np.array(record)}
            with suppress(ScoupError, OSError):
                write_npz(self._path, arrays, overwrite=True)
                files = sorted(self._path.parent.iterdir(), key=lambda file: file.stat().st_mtime)
                for file in files[:-_MOST_FILES]:
                    file.unlink()
        return (model, probe), encode


def cached_vectors(
    model: ModelIdentity, probe: Tensor, words: Sequence[str], encode: EncodeUnit, folder: str = "words"
) -> Tensor:
    """Return unit vectors of words [B, D] float32: those in the cache, else encoded and written there.

    Both have the same bytes. A file that is damaged or of another model is replaced, and a
    cache that cannot be written is not used. ``probe`` [1, D] is the model's vector of ``PROBE``; ``encode`` returns
    vectors of unit norm.
    """
    key = [_VERSION, PROBE, astuple(model), words]
    path, names = _path(folder, f"{model.name} {model.revision}", key), (PROBE, *words)
    if path is not None and (known := _read(path, names, probe)) is not None:
        return known
    vectors = torch.cat([probe, encode(words)])
    arrays = {"names": np.array(names), "vectors": vectors.numpy(), MODEL_KEY: np.array(model.name)}
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


def _path(folder: str, name: str, key: object) -> Path | None:
    """Return the file of a key in a folder of the cache."""
    cache = cache_folder()
    if cache is None:
        return None
    digest = hashlib.sha256(json.dumps(key).encode())
    return cache / folder / f"{slug(name)}-{digest.hexdigest()[:16]}.npz"


def _read_model(path: Path, key: list[Any]) -> tuple[ModelIdentity, Tensor] | None:
    """Return the model that a name has opened, and its vector of the probe; None unless the file says so."""
    try:
        table = WordTable.load(path)
        known, (name, revision, package, files) = json.loads(table.model)
        model = ModelIdentity(name, revision, package, tuple(files))
    except (ScoupError, OSError, ValueError, TypeError):
        return None
    is_own = known == key and table.names == (PROBE,)
    return (model, torch.from_numpy(table.vectors)) if is_own else None


def _read(path: Path, names: Sequence[str], probe: Tensor) -> Tensor | None:
    """Return the vectors of all names but the first; None unless the file is whole and of this model."""
    try:
        table = WordTable.load(path)
    except (ScoupError, OSError):
        return None
    vectors = torch.from_numpy(table.vectors)
    if table.names != tuple(names) or vectors.shape[1:] != probe.shape[1:]:
        return None
    return vectors[1:] if _alike(vectors[:1], probe) else None


def _alike(first: Tensor, second: Tensor) -> bool:
    return first.shape == second.shape and float(first[0].double() @ second[0].double()) >= _LEAST_COSINE
