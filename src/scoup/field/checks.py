"""The rules for a field's codes, things and names, in memory and in its file, and for the rest of a ``.scoup`` file:
its header, cameras and geometry. All without torch.

``TENSORS`` is the table of docs/formats.md. Checks raise a ValueError or a KeyError, which ``container`` turns into one
error that names the file.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scoup.base import InputError, WorldFrame, geometry_fingerprint

if TYPE_CHECKING:
    from torch import Tensor

Arrays = Mapping[str, NDArray[Any]]
Table = Mapping[str, tuple[str, str]]
"""Name -> possible types, and sides: a letter stands for the same number in all arrays."""

MOST_THINGS = 65535
"""Files hold their numbers in 16 bits, and this one says that there is none."""
CODES: Table = {
    "code_indices": ("uint8 uint16", "N S K"),
    "code_weights": ("uint8 float16", "N S K"),
    "codebook": ("float16 float32", "S L D"),
}
THINGS: Table = {
    "things.owners": ("uint16", "N S"),
    "things.levels": ("uint8", "T"),
    "things.parents": ("uint16", "T"),
    "things.embeddings": ("float16", "T D"),
    "things.agreement": ("float32", "T"),
    "things.n_regions": ("int32", "T"),
    "things.mass": ("float32", "T"),
    "things.stability": ("float32", "T"),
}
THINGS_IN_MEMORY: Table = {**THINGS, "things.owners": ("int32", "N S"), "things.parents": ("int32", "T")}
NAMES: Table = {
    "names.presence": ("float32", "M"),
    "names.rows": ("int32", "E"),
    "names.things": ("int32", "E"),
    "names.votes": ("float32", "E"),
}
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

_INFINITY, _SIGN = 0x7C00, 0x8000  # bits of float16


def check_shapes(arrays: Arrays, table: Table, sides: dict[str, int]) -> None:
    """Refuse arrays whose types or shapes differ from a table. ``sides`` has the known numbers, and gets the others
    from the arrays; a KeyError for a missing array."""
    for name, (types, shape) in table.items():
        array, letters = arrays[name], shape.split()
        fits = str(array.dtype) in types.split() and array.ndim == len(letters)
        for letter, side in zip(letters, array.shape, strict=False):
            fits &= side == (int(letter) if letter.isdigit() else sides.setdefault(letter, side))
        if not fits:
            known = ", ".join(f"{letter} = {side}" for letter, side in sides.items())
            raise InputError(
                f"{name} is {array.dtype} {list(array.shape)}, expected {types.replace(' ', ' or ')} "
                f"[{', '.join(letters)}] with {known}"
            )


def check_finite(name: str, array: NDArray[Any]) -> None:
    """Refuse an array with NaN or infinite values."""
    if not np.isfinite(array).all():
        raise InputError(f"{name} contains values that are not finite")


def weight_bits(weights: NDArray[Any]) -> NDArray[Any]:
    """Return code weights as whole numbers in the same order, 0 for 0."""
    return weights if weights.dtype == np.uint8 else weights.view(np.uint16) & ~np.uint16(_SIGN)


def check_codes(arrays: Arrays, sides: dict[str, int]) -> None:
    """Refuse codes and a codebook that do not fit together, or ``sides``."""
    check_shapes(arrays, CODES, sides)
    indices, weights, codebook = (arrays[name] for name in CODES)
    atoms = sides["L"]
    if not all(sides[letter] for letter in "SKLD"):
        raise InputError(f"codes {list(indices.shape)} and codebook {list(codebook.shape)} are empty")
    wanted = "uint8" if atoms <= 256 else "uint16"
    if indices.dtype != wanted:
        raise InputError(f"code_indices are {indices.dtype}, expected {wanted} for {atoms} atoms")
    if int(indices.max(initial=0)) >= atoms:
        raise InputError(f"a code index is beyond the {atoms} atoms of the codebook")
    # Finite numbers that are not negative have bits below these of infinity, so most weights are read once.
    if weights.dtype == np.float16 and int(weights.view(np.uint16).max(initial=0)) >= _INFINITY:
        if int(weight_bits(weights).max(initial=0)) >= _INFINITY:
            raise InputError("code_weights contains values that are not finite")
        if int(weights.view(np.uint16).max(initial=0)) > _SIGN:
            raise InputError("a code weight is negative")
    check_finite("codebook", codebook)


def check_things(arrays: Arrays, sides: dict[str, int], table: Table = THINGS) -> None:
    """Refuse things that do not fit together, or ``sides``; ``table`` has their types in a file or in memory."""
    check_shapes(arrays, table, sides)
    count = sides["T"]
    if count > MOST_THINGS:
        raise InputError(f"{count:,} things; at most {MOST_THINGS:,} are possible")
    for name in ("things.owners", "things.parents"):
        # As bits without a sign, the number for none is the largest in memory, too.
        numbers = arrays[name]
        numbers = numbers.view(np.uint32) if numbers.dtype == np.int32 else numbers
        if ((numbers >= count) & (numbers != np.iinfo(numbers.dtype).max)).any():
            raise InputError(f"{name} names a thing beyond the {count}")
    if int(arrays["things.levels"].max(initial=0)) >= sides["S"]:
        raise InputError(f"a thing is of a level beyond the {sides['S']}")
    for name in ("things.embeddings", "things.agreement", "things.mass", "things.stability"):
        check_finite(name, arrays[name])


def check_names(arrays: Arrays, sides: dict[str, int]) -> None:
    """Refuse names of things that do not fit together, or ``sides``."""
    check_shapes(arrays, NAMES, sides)
    for name, count in {"names.rows": sides["M"], "names.things": sides["T"]}.items():
        if not ((arrays[name] >= 0) & (arrays[name] < count)).all():
            raise InputError(f"{name} is beyond the {count}")
    for name in ("names.presence", "names.votes"):
        check_finite(name, arrays[name])


def tensor_array(tensor: Tensor) -> np.ndarray:
    """Return a tensor as an array, on the CPU a view of it."""
    try:
        return tensor.detach().cpu().numpy()
    except TypeError:
        raise InputError(f"tensors of {tensor.dtype} cannot be used") from None


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
