"""Facts and sizes of a field's file, read without torch, which takes longer to start than they take to read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.field.checks import LEAST_GAUSSIANS, weight_bits
from scoup.field.container import place_of, read_content

DOUBTFUL_SHARE = 0.4
"""A thing with this share of its level's Gaussians makes answers doubtful. Of nineteen fields, no other figure orders
settings as well by their mIoU (docs/answers.md#where-a-field-is-unsure)."""


def part_sizes(path: Path) -> str:
    """Return the sizes of the parts of a ``.scoup`` file in words, for people."""
    arrays = read_content(path)[1]
    count = max(1, len(arrays["code_indices"]))
    owners = (
        f" and {arrays['things.owners'].nbytes / count:.0f} of things" if "things.owners" in arrays else ""
    )
    codebook = f"a codebook of {arrays['codebook'].nbytes / 1e3:,.0f} kB"
    return f"{_bytes_of_codes(arrays):.0f} bytes of codes{owners} a Gaussian, {codebook}"


def read_facts(path: Path) -> dict[str, Any]:
    """Read a ``.scoup`` file, check all of it as ``LanguageField.load`` does, and return its facts as plain values."""
    header, arrays = read_content(path)
    geometry = header["geometry"]
    count, _, k = arrays["code_indices"].shape
    _, atoms, dim = arrays["codebook"].shape
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
        "bytes_of_codes_a_gaussian": round(_bytes_of_codes(arrays), 1),
        "bytes_of_codebook": arrays["codebook"].nbytes,
        "cameras": len(header["cameras"] or ()),
        **_facts_of_things(arrays),
        "geometry": "embedded" if "geometry.means" in arrays else _where(place_of(path, geometry["path"])),
        "fingerprint": geometry["fingerprint"],
        **({"frame": header["frame"]} if "frame" in header else {}),
        "provenance": header["provenance"],
    }


def _bytes_of_codes(arrays: Mapping[str, NDArray[Any]]) -> float:
    """Return the bytes of codes per Gaussian, of all levels."""
    indices, weights = arrays["code_indices"], arrays["code_weights"]
    return (indices.nbytes + weights.nbytes) / max(1, len(indices))


def _facts_of_things(arrays: Mapping[str, NDArray[Any]]) -> dict[str, Any]:
    """Return the number of things in ``field.things()``, and the share of the largest."""
    if "things.owners" not in arrays:
        return {"things": 0}
    owners, levels = arrays["things.owners"], arrays["things.levels"]
    count = int(np.count_nonzero(np.bincount(owners.ravel())[: len(levels)] >= LEAST_GAUSSIANS))
    share = _largest_share(owners, levels)
    doubt = _doubt(share)
    return {"things": count, "largest_thing": round(share, 3), **({"doubt": doubt} if doubt else {})}


def doubt_of(owners: NDArray[Any], levels: NDArray[Any]) -> str:
    """Return what makes the answers of things with owners [N, S] and levels [T] doubtful, as a sentence without its
    end; "" if nothing does."""
    return _doubt(_largest_share(owners, levels))


def _doubt(share: float) -> str:
    if share < DOUBTFUL_SHARE:
        return ""
    return f"a thing has {share:.0%} of the Gaussians of its level: answers may be poor"


def _largest_share(owners: NDArray[Any], levels: NDArray[Any]) -> float:
    """Return the largest share that a thing has of the Gaussians of its level; 0 without things."""
    counts = np.bincount(
        owners[(owners >= 0) & (owners < len(levels))].astype(np.int64), minlength=len(levels)
    )
    wholes = np.bincount(levels, counts, minlength=1)
    return float((counts / np.maximum(1, wholes[levels])).max(initial=0))


def _where(path: Path | None) -> str | None:
    """Return the path of a file that the field names, and whether it is missing."""
    return None if path is None else str(path) + ("" if os.path.exists(path) else " (not there)")
