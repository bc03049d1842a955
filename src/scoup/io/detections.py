"""Detections of texts in photographs: a folder with ``concepts.json`` and one JSON file per photograph."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import torch

from scoup.base import (
    FileFormatError,
    InputError,
    JsonNode,
    MissingFileError,
    check_format_version,
    write_text,
)
from scoup.io.reading import read_json
from scoup.io.regions.compact import stem_of
from scoup.scene import Detections

MANIFEST = "concepts.json"
SCHEMA = "scoup.concepts"
VERSION = 1
_REMEDY = "look for the words again"


@dataclass(frozen=True)
class DetectionStore:
    """A folder of detections, all made by one model with the same texts."""

    folder: Path
    texts: tuple[str, ...]
    settings: dict[str, Any]  # of the model, as plain JSON values
    FOLDER: ClassVar = "concepts"
    """Of the name, inside the folder of the region features."""

    @property
    def fingerprint(self) -> str:
        """Hash of texts and settings: files made with others do not count."""
        text = json.dumps([self.texts, self.settings], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    @classmethod
    def open(cls, folder: Path) -> DetectionStore:
        """Open a folder that ``begin`` has made."""
        if not (folder / MANIFEST).is_file():
            raise MissingFileError(folder / MANIFEST, "there are no detections", _REMEDY)
        record = read_json(folder / MANIFEST, "the manifest of a folder of detections", _REMEDY)
        record.get("schema").text((SCHEMA,))
        check_format_version(folder / MANIFEST, record.get("version").value, VERSION)
        texts = tuple(item.text() for item in record.get("texts").items())
        return cls(folder, texts, record.get("settings").object())

    @classmethod
    def beside(cls, features: Path) -> DetectionStore | None:
        """Return the detections beside region features; None if there are none."""
        folder = features / cls.FOLDER
        return cls.open(folder) if (folder / MANIFEST).is_file() else None

    @classmethod
    def new(cls, folder: Path, texts: Sequence[str], settings: dict[str, Any]) -> DetectionStore:
        """Return the store of texts and a model, to ``begin`` and write to."""
        words = tuple(dict.fromkeys(texts))
        if not words:
            raise InputError("pass at least one word to look for")
        return cls(folder, words, settings)

    def begin(self, overwrite: bool = False) -> None:
        """Write the manifest, unless it is there.

        Raises:
            InputError: the folder contains detections of another model or of other texts.
        """
        if (self.folder / MANIFEST).is_file() and not overwrite:
            if DetectionStore.open(self.folder).fingerprint != self.fingerprint:
                raise InputError(
                    f"{self.folder}: contains detections of other words or of another model; pass `overwrite=True` "
                    "to make them again"
                )
            return
        record = {"schema": SCHEMA, "version": VERSION, "settings": self.settings, "texts": list(self.texts)}
        self.folder.mkdir(parents=True, exist_ok=True)
        write_text(self.folder / MANIFEST, json.dumps(record, indent=2) + "\n", True, wait=True)

    def has(self, name: str, photograph: str) -> bool:
        """Return whether a photograph (by its SHA-256) was looked at."""
        try:
            record = self._record(name)
        except FileFormatError:  # made again
            return False
        return record is not None and record.get("photograph").value == photograph

    def write(self, name: str, photograph: str, result: Detections) -> None:
        """Write the detections of a photograph; masks are left out."""
        numbers = zip(result.texts.tolist(), result.scores.tolist(), result.boxes.tolist(), strict=True)
        record = {
            "name": name,
            "manifest": self.fingerprint,
            "photograph": photograph,
            "size": list(result.size),
            "detections": [
                [text, round(score, 4), *(round(side, 1) for side in box)] for text, score, box in numbers
            ],
        }
        path = self._file(name)
        path.parent.mkdir(parents=True, exist_ok=True)  # names may have folders
        write_text(path, json.dumps(record, separators=(",", ":")) + "\n", True)

    def read(self, name: str) -> Detections | None:
        """Return the detections of a photograph; None if it was not looked at with these texts and this model."""
        path, record = self._file(name), self._record(name)
        if record is None:
            return None
        try:
            rows = torch.tensor(record.get("detections").value, dtype=torch.float64).reshape(-1, 6)
            width, height = (int(side) for side in record.get("size").value)
        except (TypeError, ValueError, RuntimeError, OverflowError) as error:
            raise FileFormatError(path, f"contains no detections ({error})", _REMEDY) from error
        texts = rows[:, 0].long()
        if not bool(rows.isfinite().all()) or bool(((texts < 0) | (texts >= len(self.texts))).any()):
            raise FileFormatError(path, "contains detections of unknown texts, or without numbers", _REMEDY)
        if min(width, height) < 1:
            raise FileFormatError(path, f"is of a photograph of {width} x {height} pixels", _REMEDY)
        return Detections(texts, rows[:, 1].float(), rows[:, 2:].float(), (width, height))

    def of(self, names: Iterable[str]) -> dict[str, Detections]:
        """Return the detections of the photographs among ``names`` that were looked at."""
        stored = {name: self.read(name) for name in names}
        return {name: detections for name, detections in stored.items() if detections is not None}

    def _record(self, name: str) -> JsonNode | None:
        """Return the record of a photograph, if it was made with these texts and this model."""
        if not self._file(name).is_file():
            return None
        record = read_json(self._file(name), "detections", _REMEDY)
        return record if record.get("manifest").value == self.fingerprint else None

    def _file(self, name: str) -> Path:
        return self.folder / f"{stem_of(name)}.json"
