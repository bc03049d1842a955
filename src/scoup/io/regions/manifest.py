"""``regions.json``: settings and photographs of a folder of region features."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scoup.base import InputError, OutputExistsError, check_format_version, write_text
from scoup.io.reading import read_json

MANIFEST = "regions.json"
SCHEMA = "scoup.regions"
VERSION = 1

LAYOUT = "compact"  # of the files: the only one that is written


@dataclass(frozen=True)
class RegionManifest:
    """The settings that all views of a folder share."""

    embedding_model: str  # id of the model that made the embeddings; "" if it is not known
    # everything else that decides the numbers; plain JSON values
    settings: dict[str, Any] = field(default_factory=dict)
    # names of the photographs that were chosen, in their order; none where all are taken. They decide no numbers.
    views: tuple[str, ...] = field(default=(), compare=False)

    @classmethod
    def of(cls, embedding_model: str, settings: dict[str, Any], bits: int) -> RegionManifest:
        """Return the manifest of new features with embeddings of 16 or 32 bits."""
        if bits not in (16, 32):
            raise InputError(f"embeddings must have 16 or 32 bits, got {bits}")
        return cls(embedding_model, settings | {"bits": bits})

    @classmethod
    def read(cls, folder: Path) -> RegionManifest | None:
        """Return the manifest of a folder of region features; None where there is none."""
        path = folder / MANIFEST
        if not path.is_file():
            return None
        remedy = "extract the features again into another folder"
        record = read_json(path, "the manifest of a folder of region features", remedy)
        record.get("schema").text((SCHEMA,))
        check_format_version(path, record.get("version").value, VERSION)
        record.get("layout").text((LAYOUT,))
        settings = record.get("settings").object()
        model = record.get("embedding_model")
        if model.value != "":  # not known
            model.text()
        views = record.get("views")
        names = () if views.value is None else tuple(name.text() for name in views.items())
        return cls(model.value, settings, names)

    @property
    def bits(self) -> int:
        return int(self.settings.get("bits", 16))

    @property
    def fingerprint(self) -> str:
        """Hash of all of it: views made under another manifest do not count."""
        text = json.dumps([LAYOUT, self.embedding_model, self.settings], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:32]

    def differences(self, other: RegionManifest) -> list[str]:
        """Return what differs from another manifest, as "name: this one, not the other"."""
        pairs: dict[str, tuple[Any, Any]] = {"embedding model": (self.embedding_model, other.embedding_model)}
        for name in sorted({*self.settings, *other.settings}):
            pairs[name] = (self.settings.get(name), other.settings.get(name))
        return [
            f"{name}: {_short(ours)}, not {_short(theirs)}"
            for name, (ours, theirs) in pairs.items()
            if ours != theirs
        ]


def write_manifest(folder: Path, manifest: RegionManifest, overwrite: bool = False) -> None:
    """Write a folder's manifest atomically. Several processes may do so at once if they agree."""
    record = {
        "schema": SCHEMA,
        "version": VERSION,
        "layout": LAYOUT,
        "embedding_model": manifest.embedding_model,
        "settings": manifest.settings,
        **({"views": manifest.views} if manifest.views else {}),
    }
    text = json.dumps(record, indent=2, sort_keys=True) + "\n"
    try:
        write_text(folder / MANIFEST, text, overwrite, wait=True)
    except OutputExistsError:
        there = RegionManifest.read(folder)
        if there is None or there != manifest:
            raise InputError(
                f"{folder / MANIFEST}: another process has written another one meanwhile"
            ) from None


def _short(value: Any) -> str:
    text = "none" if value is None else json.dumps(value) if not isinstance(value, str) else value
    return text if len(text) <= 60 else text[:57] + "..."
