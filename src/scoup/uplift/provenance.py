"""The record of a field's build that goes into its file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from torch import Tensor

from scoup.base import VERSION, InputError
from scoup.io import RegionManifest
from scoup.models import WordTable, check_model
from scoup.scene import Regions
from scoup.uplift.settings import BuildSettings
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.things import FoundThings


def embedding_source(features: Path, regions: Regions, named: str | None = None) -> tuple[str, Path | None]:
    """Return the embedding model and the word table for ``build``; "" and None where unknown. ``named`` is a model,
    which takes precedence over the manifest of the regions in ``features``, or a word table.

    Raises:
        FileFormatError, InputError: what is named is neither, or a table of vectors of another size.
    """
    manifest = RegionManifest.read(features)
    made_by = manifest.embedding_model if manifest else ""
    if named is None:
        return made_by, None
    if not WordTable.is_meant(named):
        check_model(named)
        return named, None
    table = WordTable.load(named)
    dim = table.vectors.shape[1]
    wanted = regions.load_embeddings(regions.view_names[0], regions.levels[0]).shape[1]
    if dim != wanted:
        raise InputError(
            f"{named}: contains vectors of {dim} dimensions, but {features} contains embeddings of "
            f"{wanted}; use the table made with the same model"
        )
    return made_by, Path(named)


@dataclass(frozen=True)
class FieldSources:
    """The sources that a field names.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> sources = scoup.FieldSources(words="scene/words.npz", geometry_path="scene/point_cloud.ply")
        >>> field = scoup.build(gaussians, cameras, scoup.load_regions("scene", cameras), sources=sources)
        >>> field.answer("kettle").level in field.levels
        True
    """

    embedding_model: str = ""
    """Id of the model the embeddings come from; by default the one that the word table names."""
    words: str | Path | None = None
    """The word table that encodes texts in place of this model."""
    geometry_path: str | Path | None = None
    """File of the Gaussians. A field that names none is saved with its Gaussians."""

    @property
    def table(self) -> Path | None:
        """``words`` as a path."""
        return None if self.words is None else Path(self.words)


def recorded_model(embedding_model: str, words: str | Path | None) -> str:
    """Return the embedding model for a field to record: the one given, or the one that its word table names."""
    return embedding_model if embedding_model or words is None else WordTable.load(words).model


def build_record(
    settings: BuildSettings,
    inputs: str,
    sums: RegionSums,
    reports: Sequence[dict[str, Any]],
    sharpness: Tensor | None,
    things: FoundThings | None,
) -> dict[str, Any]:
    """Return the record of a build.

    ``inputs`` is the ``region_codes.inputs_digest``, ``reports`` are those of the codes per level, ``sharpness`` [S] is
    that of the rounds after the first, ``things`` are the things found.
    """
    names = list(sums.views)
    label_maps = json.dumps({name: view.labels_digest for name, view in sums.views.items()}, sort_keys=True)
    record: dict[str, Any] = {
        "software": f"scoup {VERSION}",
        "settings": settings.to_dict(),
        "inputs": inputs,
        "label_maps": hashlib.sha256(label_maps.encode()).hexdigest(),
        "views": names,
        "coding": dict(zip(sums.levels, reports, strict=True)),
    }
    if sharpness is not None:
        record["sharpness"] = sharpness.tolist()
    if things is not None:
        record["strays"] = dict(zip(sums.levels, things.strays, strict=False))
    return record
