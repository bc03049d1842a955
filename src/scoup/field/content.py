"""The contents of a valid ``.scoup`` file: its header and its tensors, checked without torch.

``TENSORS`` is the table of docs/formats.md. Checks raise a ValueError or a KeyError, which ``container`` turns into one
error that names the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.scene.fingerprint import geometry_fingerprint

Arrays = Mapping[str, NDArray[Any]]

NO_NUMBER = 65535
"""In ``things.owners`` and ``things.parents``: no thing."""
SH_BASES = (1, 4, 9, 16, 25)
LEAST_GAUSSIANS = 10
"""Fewer are a stray, not a thing."""

TENSORS: Mapping[str, tuple[str, str]] = {
    "code_indices": ("uint8 uint16", "N S K"),
    "code_weights": ("uint8 float16", "N S K"),
    "codebook": ("float16 float32", "S L D"),
    "things.owners": ("uint16", "N S"),
    "things.levels": ("uint8", "T"),
    "things.parents": ("uint16", "T"),
    "things.embeddings": ("float16", "T D"),
    "things.agreement": ("float32", "T"),
    "things.n_regions": ("int32", "T"),
    "things.mass": ("float32", "T"),
    "things.stability": ("float32", "T"),
    "names.presence": ("float32", "M"),
    "names.rows": ("int32", "E"),
    "names.things": ("int32", "E"),
    "names.votes": ("float32", "E"),
    "cameras.viewmats": ("float64", "V 4 4"),
    "cameras.Ks": ("float64", "V 3 3"),
    "cameras.sizes": ("int32", "V 2"),
    "geometry.means": ("float32", "N 3"),
    "geometry.quats": ("float32", "N 4"),
    "geometry.scales": ("float32", "N 3"),
    "geometry.opacities": ("float32", "N"),
    "geometry.sh": ("float32", "N B 3"),
}
"""Name -> possible types, and sides: a letter stands for the same number in all tensors. Names with a dot are optional,
but those with the same beginning only together."""

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
_INFINITY, _SIGN = 0x7C00, 0x8000  # bits of float16
_DETERMINANT = 0.0099  # from 1; ``Camera`` allows 0.01, by another routine


def check_content(header: Mapping[str, Any], arrays: Arrays) -> None:
    """Check that a header and tensors are those of a language field; everything that ``LanguageField`` expects."""
    _check_types(header, _HEADER)
    _check_types(header["geometry"], _GEOMETRY)
    cameras = header["cameras"] or []
    names = header.get("names", [])
    if not isinstance(names, list) or not all(
        isinstance(name, str) for name in (*header["levels"], *cameras, *names)
    ):
        raise ValueError("a name of a level, camera or thing is not a text")
    for what, texts in {"cameras": cameras, "names of things": names}.items():
        if len(set(texts)) < len(texts):
            raise ValueError(f"two {what} are one text")
    sides = _sides(header, arrays)
    counts = {
        "N": header["geometry"]["n_gaussians"],
        "S": len(header["levels"]),
        "V": len(cameras),
        "M": len(names),
    }
    letters = {"N": "Gaussians", "S": "levels", "V": "cameras", "M": "names of things"}
    for letter, what in letters.items():
        if sides.get(letter, 0) != counts[letter]:
            raise ValueError(
                f"has {counts[letter]} {what} by its header, {sides.get(letter, 0)} by its tensors"
            )
    _check_codes(arrays, sides)
    if "T" in sides:
        _check_things(arrays, sides)
    if "E" in sides:
        _check_names(arrays, sides)
    if "V" in sides:
        _check_cameras(arrays)
    if "B" in sides:
        _check_geometry(header, arrays, sides)


def check_finite(name: str, array: NDArray[Any]) -> None:
    """Refuse an array with NaN or infinite values."""
    if not np.isfinite(array).all():
        raise ValueError(f"{name} contains values that are not finite")


def weight_bits(weights: NDArray[Any]) -> NDArray[Any]:
    """Return code weights as whole numbers in the same order, 0 for 0."""
    return weights if weights.dtype == np.uint8 else weights.view(np.uint16) & ~np.uint16(_SIGN)


def _check_types(header: Mapping[str, Any], types: Mapping[str, tuple[type, ...]]) -> None:
    for name, allowed in types.items():
        if not isinstance(header[name], allowed):
            raise ValueError(f"{name} is {type(header[name]).__name__} in the header")


def _sides(header: Mapping[str, Any], arrays: Arrays) -> dict[str, int]:
    """Return the number that each letter of ``TENSORS`` stands for, after a check of all types and shapes."""
    unknown = arrays.keys() - TENSORS.keys()
    if unknown:
        raise ValueError(f"unknown tensors {', '.join(sorted(unknown))}")
    groups = {name.split(".")[0] for name in arrays if "." in name}
    groups |= {group for group in ("cameras", "names") if header.get(group) is not None}
    sides: dict[str, int] = {}
    for name, (types, shape) in TENSORS.items():
        if "." in name and name.split(".")[0] not in groups:
            continue
        array, letters = arrays[name], shape.split()
        fits = str(array.dtype) in types.split() and array.ndim == len(letters)
        for letter, side in zip(letters, array.shape, strict=False):
            fits &= side == (int(letter) if letter.isdigit() else sides.setdefault(letter, side))
        if not fits:
            known = ", ".join(f"{letter} = {side}" for letter, side in sides.items())
            raise ValueError(
                f"{name} is {array.dtype} {list(array.shape)}, expected {types.replace(' ', ' or ')} "
                f"[{', '.join(letters)}] with {known}"
            )
    return sides


def _check_codes(arrays: Arrays, sides: Mapping[str, int]) -> None:
    indices, weights, codebook = (arrays[name] for name in ("code_indices", "code_weights", "codebook"))
    atoms = sides["L"]
    if not all(sides[letter] for letter in "SKLD"):
        raise ValueError(f"codes {list(indices.shape)} and codebook {list(codebook.shape)} are empty")
    wanted = "uint8" if atoms <= 256 else "uint16"
    if indices.dtype != wanted:
        raise ValueError(f"code_indices are {indices.dtype}, expected {wanted} for {atoms} atoms")
    if int(indices.max(initial=0)) >= atoms:
        raise ValueError(f"a code index is beyond the {atoms} atoms of the codebook")
    if weights.dtype == np.float16:
        if int(weight_bits(weights).max(initial=0)) >= _INFINITY:
            raise ValueError("code_weights contains values that are not finite")
        if int(weights.view(np.uint16).max(initial=0)) > _SIGN:
            raise ValueError("a code weight is negative")
    check_finite("codebook", codebook)


def _check_things(arrays: Arrays, sides: Mapping[str, int]) -> None:
    count = sides["T"]
    if count > NO_NUMBER:
        raise ValueError(f"{count:,} things; at most {NO_NUMBER:,} are possible")
    for name in ("things.owners", "things.parents"):
        if ((arrays[name] >= count) & (arrays[name] != NO_NUMBER)).any():
            raise ValueError(f"{name} names a thing beyond the {count}")
    if int(arrays["things.levels"].max(initial=0)) >= sides["S"]:
        raise ValueError(f"a thing is of a level beyond the {sides['S']}")
    for name in ("things.embeddings", "things.agreement", "things.mass", "things.stability"):
        check_finite(name, arrays[name])


def _check_names(arrays: Arrays, sides: Mapping[str, int]) -> None:
    for name, count in {"names.rows": sides["M"], "names.things": sides.get("T", 0)}.items():
        if not ((arrays[name] >= 0) & (arrays[name] < count)).all():
            raise ValueError(f"{name} is beyond the {count}")
    for name in ("names.presence", "names.votes"):
        check_finite(name, arrays[name])


def _check_cameras(arrays: Arrays) -> None:
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


def _check_geometry(header: Mapping[str, Any], arrays: Arrays, sides: Mapping[str, int]) -> None:
    if sides["B"] not in SH_BASES:
        raise ValueError(f"geometry.sh has {sides['B']} coefficients, expected one of {SH_BASES}")
    columns = (arrays[f"geometry.{name}"] for name in ("means", "quats", "scales", "opacities"))
    if geometry_fingerprint(*columns) != header["geometry"]["fingerprint"]:
        raise ValueError("its Gaussians have another fingerprint than its header")
