"""What a field was made from: the record that goes into its file."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.version import VERSION
from scoup.io.regions.manifest import read_manifest
from scoup.models.word_table import is_table, load_table
from scoup.scene.regions import Regions
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.region_codes import RegionCodes
from scoup.uplift.region_sums import RegionSums


def labels_digest(sums: RegionSums, view_names: Sequence[str]) -> str:
    """SHA-256 of the label maps of views."""
    digests = {name: sums.views[name].labels_digest for name in view_names}
    return hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()


def embedding_model_of(features: Path, regions: Regions, field: Path, named: str | None = None) -> str:
    """The embedding model that a field is to name; "" where nothing says which it is.

    Args:
        features: folder of the regions, whose manifest names the model.
        regions: those of the folder.
        field: the file to be written.
        named: a model, or a word table; the table is named relative to the field.

    Raises:
        InputError: the vectors of the table are of another size than the embeddings of the regions.
    """
    if named is None:
        manifest = read_manifest(features)
        return manifest.embedding_model if manifest else ""
    if not is_table(named):
        return named
    dim = load_table(named).vectors.shape[1]
    wanted = regions.load_embeddings(regions.view_names[0], regions.levels[0]).shape[1]
    if dim != wanted:
        raise InputError(
            f"{named}: holds vectors of {dim} dimensions, but {features} holds embeddings of "
            f"{wanted}; give the table that was made with the same model"
        )
    return Path(os.path.relpath(named, field.absolute().parent)).as_posix()


def build_record(
    settings: BuildSettings,
    inputs: str,
    sums: RegionSums,
    codes: RegionCodes,
    sharpness: Tensor | None,
) -> dict[str, Any]:
    """What a field records of its build.

    Args:
        settings: of the build.
        inputs: the ``region_codes.inputs_digest``.
        sums: of the views that voted.
        codes: of their regions.
        sharpness: [S], of the rounds after the first; None after a single round.
    """
    names = list(sums.views)
    record: dict[str, Any] = {
        "software": f"scoup {VERSION}",
        "settings": asdict(settings),
        "inputs": inputs,
        "label_maps": labels_digest(sums, names),
        "views": names,
        "coding": dict(zip(sums.levels, codes.reports, strict=True)),
    }
    if sharpness is not None:
        record["sharpness"] = sharpness.tolist()
    if (sums.weights, sums.least_weight) != ("float32", 0):
        record["region_sums"] = {"weights": sums.weights, "least_weight": sums.least_weight}
    return record
