"""The contents of a valid ``.scoup`` file: its header and its tensors, checked without torch.

``TENSORS`` is the table of docs/formats.md. Checks raise a ValueError or a KeyError, which ``container`` turns into one
error that names the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from scoup.base import WorldFrame, geometry_fingerprint
from scoup.field.checks import (
    CODES,
    NAMES,
    THINGS,
    Arrays,
    Table,
    check_codes,
    check_finite,
    check_names,
    check_shapes,
    check_things,
)

SH_BASES = (1, 4, 9, 16, 25)
LEAST_GAUSSIANS = 10
"""Fewer are a stray, not a thing."""
CAMERAS: Table = {
    "cameras.viewmats": ("float64", "V 4 4"),
    "cameras.Ks": ("float64", "V 3 3"),
    "cameras.sizes": ("int32", "V 2"),
}
GEOMETRY: Table = {
    "geometry.means": ("float32", "N 3"),
    "geometry.quats": ("float32", "N 4"),
    "geometry.scales": ("float32", "N 3"),
    "geometry.opacities": ("float32", "N"),
    "geometry.sh": ("float32", "N B 3"),
}
TENSORS: Table = {**CODES, **THINGS, **NAMES, **CAMERAS, **GEOMETRY}
"""Names with a dot are optional, but those with the same beginning only together."""

_HEADER: Mapping[str, tuple[type, ...]] = {
    "levels": (list,),
    "embedding_model": (str,),
    "words": (str, type(None)),
    "raster_preset": (str,),
    "geometry": (dict,),
    "cameras": (list, type(None)),
    "provenance": (dict,),
}
_GEOMETRY: Mapping[str, tuple[type, ...]] = {
    "fingerprint": (str,),
    "n_gaussians": (int,),
    "path": (str, type(None)),
}
_DETERMINANT = 0.0099  # from 1; ``Camera`` allows 0.01, by another routine


def check_content(header: Mapping[str, Any], arrays: Arrays) -> None:
    """Check that a header and tensors are those of a language field; everything that ``LanguageField`` expects."""
    _check_types(header, _HEADER)
    _check_types(header["geometry"], _GEOMETRY)
    WorldFrame.of_header(header)
    cameras = header["cameras"] or []
    names = header.get("names", [])
    if not isinstance(names, list) or not all(
        isinstance(name, str) for name in (*header["levels"], *cameras, *names)
    ):
        raise ValueError("a name of a level, camera or thing is not a text")
    for what, texts in {"cameras": cameras, "names of things": names}.items():
        if len(set(texts)) < len(texts):
            raise ValueError(f"two {what} are one text")
    unknown = arrays.keys() - TENSORS.keys()
    if unknown:
        raise ValueError(f"unknown tensors {', '.join(sorted(unknown))}")
    sides = {
        "N": header["geometry"]["n_gaussians"],
        "S": len(header["levels"]),
        "V": len(cameras),
        "M": len(names),
    }
    groups = {name.split(".")[0] for name in arrays if "." in name}
    groups |= {group for group in ("cameras", "names") if header.get(group) is not None}
    check_codes(arrays, sides)
    if "things" in groups:
        check_things(arrays, sides)
    if "names" in groups:
        check_names(arrays, {"T": 0, **sides})
    if "cameras" in groups:
        _check_cameras(arrays, sides)
    if "geometry" in groups:
        _check_geometry(header, arrays, sides)


def _check_types(header: Mapping[str, Any], types: Mapping[str, tuple[type, ...]]) -> None:
    for name, allowed in types.items():
        if not isinstance(header[name], allowed):
            raise ValueError(f"{name} is {type(header[name]).__name__} in the header")


def _check_cameras(arrays: Arrays, sides: dict[str, int]) -> None:
    check_shapes(arrays, CAMERAS, sides)
    viewmats, intrinsics, sizes = (arrays[f"cameras.{name}"] for name in ("viewmats", "Ks", "sizes"))
    check_finite("cameras.viewmats", viewmats)
    check_finite("cameras.Ks", intrinsics)
    if (sizes < 1).any():
        raise ValueError("cameras.sizes contains one that is not an image size")
    if (intrinsics[:, [0, 1], [0, 1]] <= 0).any():
        raise ValueError("cameras.Ks contains a focal length that is not positive")
    with np.errstate(all="ignore"):
        determinants = np.linalg.det(viewmats[:, :3, :3])
    if not (np.abs(determinants - 1) < _DETERMINANT).all():
        raise ValueError("cameras.viewmats contains one that is not a rotation")


def _check_geometry(header: Mapping[str, Any], arrays: Arrays, sides: dict[str, int]) -> None:
    check_shapes(arrays, GEOMETRY, sides)
    if sides["B"] not in SH_BASES:
        raise ValueError(f"geometry.sh has {sides['B']} coefficients, expected one of {SH_BASES}")
    columns = (arrays[f"geometry.{name}"] for name in ("means", "quats", "scales", "opacities"))
    if geometry_fingerprint(*columns) != header["geometry"]["fingerprint"]:
        raise ValueError("its Gaussians have another fingerprint than its header")
