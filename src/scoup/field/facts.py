"""The facts of a language field's file, read without torch, which takes longer to start than they take to read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.field.checks import weight_bits
from scoup.field.container import place_of, read_content
from scoup.field.content import LEAST_GAUSSIANS
from scoup.field.sizes import PartSizes


def read_facts(path: Path) -> dict[str, Any]:
    """Read a ``.scoup`` file, check all of it as ``LanguageField.load`` does, and return its facts as plain values."""
    content = read_content(path)
    header, arrays = content.header, content.arrays
    geometry = header["geometry"]
    count, _, k = arrays["code_indices"].shape
    _, atoms, dim = arrays["codebook"].shape
    sizes = PartSizes.of(arrays)
    return {
        "gaussians": count,
        "coded": int(np.count_nonzero(weight_bits(arrays["code_weights"]).reshape(count, -1).any(1))),
        "levels": header["levels"],
        "atoms": atoms,
        "k": k,
        "dim": dim,
        "embedding_model": header["embedding_model"],
        "words": _where(place_of(path, header["words"])),
        "raster_preset": header["raster_preset"],
        "bytes": path.stat().st_size,
        "bytes_of_codes_a_gaussian": round(sizes.codes_a_gaussian, 1),
        "bytes_of_codebook": sizes.codebook,
        "cameras": len(header["cameras"] or ()),
        "things": _count_things(arrays),
        "geometry": "embedded" if "geometry.means" in arrays else _where(place_of(path, geometry["path"])),
        "fingerprint": geometry["fingerprint"],
        "provenance": header["provenance"],
    }


def _count_things(arrays: Mapping[str, NDArray[Any]]) -> int:
    """Return the number of things in ``field.things()``."""
    if "things.owners" not in arrays:
        return 0
    counts = np.bincount(arrays["things.owners"].ravel())
    return int(np.count_nonzero(counts[: len(arrays["things.levels"])] >= LEAST_GAUSSIANS))


def _where(path: Path | None) -> str | None:
    """Return the path of a file that the field names, and whether it is missing."""
    return None if path is None else str(path) + ("" if os.path.exists(path) else " (not there)")
