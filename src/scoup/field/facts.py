"""The facts of a language field's file, read without torch, which takes longer to start than they take to read."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from scoup.base.errors import check_format_version
from scoup.field.container import VERSION, check_sums, field_damage_named, place_of, read_container

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField

_NO_THING = 65535  # in a file
_INFINITY = 0x7C00  # bits of float16
_THINGS: Mapping[str, tuple[str, int]] = {
    "owners": ("uint16", 2),
    "levels": ("uint8", 1),
    "parents": ("uint16", 1),
    "embeddings": ("float16", 2),
    "agreement": ("float32", 1),
    "n_regions": ("int32", 1),
    "mass": ("float32", 1),
    "stability": ("float32", 1),
}


@dataclass(frozen=True)
class FieldFacts:
    """Facts of a language field, without its tensors.

    Attributes:
        gaussians: N.
        coded: Gaussians with a code at any level.
        levels: their names, fine to coarse.
        atoms: L.
        k: K.
        dim: D.
        embedding_model: whose embeddings were coded.
        words: where the word table is that encodes texts, or None.
        raster_preset: the rasteriser's constants.
        cameras: how many.
        geometry: where the Gaussians are: "embedded", a path, or None.
        fingerprint: of the geometry.
        provenance: plain JSON values.
    """

    gaussians: int
    coded: int
    levels: tuple[str, ...]
    atoms: int
    k: int
    dim: int
    embedding_model: str
    words: str | None
    raster_preset: str
    cameras: int
    geometry: str | None
    fingerprint: str
    provenance: dict[str, Any]

    @classmethod
    def of(cls, field: LanguageField) -> FieldFacts:
        """Return the facts of a field in memory."""
        place = field.geometry_path
        return cls(
            gaussians=len(field),
            coded=int(field.coded().sum()),
            levels=field.levels,
            atoms=field.n_atoms,
            k=field.code_indices.shape[2],
            dim=field.dim,
            embedding_model=field.embedding_model,
            words=_said(field.info.words),
            raster_preset=field.raster_preset,
            cameras=0 if field.cameras is None else len(field.cameras),
            geometry="embedded" if field.has_geometry else _said(place),
            fingerprint=field.fingerprint,
            provenance=field.info.provenance,
        )


def read_facts(path: Path) -> FieldFacts:
    """Read a ``.scoup`` file, check all of it as ``LanguageField.load`` does, and return its facts.

    A file with embedded Gaussians, or one that does not hold together, is loaded with torch.
    """
    text, header, arrays = read_container(path, "numpy")
    with field_damage_named(path):
        check_format_version(path, header["version"], VERSION)
        check_sums(path, text, header, arrays)
    if _holds_together(header, arrays):
        return _facts(path, header, arrays)
    from scoup.field.language_field import LanguageField

    return FieldFacts.of(LanguageField.load(path))


def _facts(path: Path, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> FieldFacts:
    count, _, k = arrays["code_indices"].shape
    _, atoms, dim = arrays["codebook"].shape
    return FieldFacts(
        gaussians=count,
        coded=int(np.count_nonzero(_bits(arrays["code_weights"]).reshape(count, -1).any(1))),
        levels=tuple(header["levels"]),
        atoms=atoms,
        k=k,
        dim=dim,
        embedding_model=header["embedding_model"],
        words=_said(place_of(path, header["words"])),
        raster_preset=header["raster_preset"],
        cameras=len(header["cameras"] or ()),
        geometry=_said(place_of(path, header["geometry"]["path"])),
        fingerprint=header["geometry"]["fingerprint"],
        provenance=header["provenance"],
    )


def _said(place: Path | None) -> str | None:
    """Return where a file is that the field names, in words."""
    return None if place is None else str(place) + ("" if os.path.exists(place) else " (not there)")


def _holds_together(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Return whether a field without embedded Gaussians would load; in doubt false, and loading it says why."""
    try:
        geometry = header["geometry"]
        texts = [
            header["embedding_model"],
            header["raster_preset"],
            geometry["fingerprint"],
            *header["levels"],
        ]
        return (
            "geometry.means" not in arrays
            and all(isinstance(text, str) for text in texts)
            and isinstance(header["provenance"], dict)
            and all(isinstance(path, (str, type(None))) for path in (geometry["path"], header["words"]))
            and _codes_hold_together(arrays, geometry["n_gaussians"], len(header["levels"]))
            and _cameras_hold_together(arrays, header["cameras"])
            and _things_hold_together(arrays)
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError):
        return False


def _codes_hold_together(arrays: Mapping[str, NDArray[Any]], count: int, n_levels: int) -> bool:
    """Check what ``scoup.scene.field_info.check_codes`` does."""
    indices, weights, codebook = (arrays[name] for name in ("code_indices", "code_weights", "codebook"))
    if indices.ndim != 3 or codebook.ndim != 3 or weights.shape != indices.shape:
        return False
    n_atoms = codebook.shape[1]
    return (
        indices.shape[:2] == (count, n_levels)
        and len(codebook) == n_levels
        and 0 not in (*indices.shape, *codebook.shape)
        and indices.dtype == (np.uint8 if n_atoms <= 256 else np.uint16)
        and int(indices.max()) < n_atoms
        and weights.dtype in (np.uint8, np.float16)
        and (weights.dtype == np.uint8 or int(_bits(weights).max()) < _INFINITY)
        and codebook.dtype in (np.float16, np.float32)
        and bool(np.isfinite(codebook).all())
    )


def _cameras_hold_together(arrays: Mapping[str, NDArray[Any]], names: list[str] | None) -> bool:
    """Check what ``Camera`` and ``Cameras`` do."""
    if names is None:
        return True
    viewmats, intrinsics, sizes = (arrays[f"cameras.{part}"] for part in ("viewmats", "Ks", "sizes"))
    count = len(names)
    if (viewmats.shape, intrinsics.shape, sizes.shape) != ((count, 4, 4), (count, 3, 3), (count, 2)):
        return False
    focal = intrinsics[:, [0, 1], [0, 1]]
    return (
        isinstance(names, list)
        and all(isinstance(name, str) for name in names)
        and len(set(names)) == count
        and viewmats.dtype == intrinsics.dtype == np.float64
        and bool(np.isfinite(viewmats).all() and np.isfinite(intrinsics).all())
        and bool((sizes >= 1).all() and (focal > 0).all())
        and bool((np.abs(np.linalg.det(viewmats[:, :3, :3]) - 1) < 0.009).all())
    )


def _things_hold_together(arrays: Mapping[str, NDArray[Any]]) -> bool:
    """Check what ``ThingTable`` and ``scoup.scene.field_info.check_things`` do."""
    found = {
        name.removeprefix("things."): part for name, part in arrays.items() if name.startswith("things.")
    }
    if not found:
        return True
    if {name: (str(part.dtype), part.ndim) for name, part in found.items()} != _THINGS:
        return False
    count, owners = len(found["levels"]), found["owners"]
    return (
        owners.shape == arrays["code_indices"].shape[:2]
        and all(len(part) == count for name, part in found.items() if name != "owners")
        and 0 < count < _NO_THING
        and found["embeddings"].shape[1] == arrays["codebook"].shape[2]
        and all(
            int(np.where(part == _NO_THING, 0, part).max(initial=0)) < count
            for part in (owners, found["parents"])
        )
        and int(found["levels"].max()) < owners.shape[1]
        and all(
            bool(np.isfinite(found[name]).all()) for name in ("embeddings", "agreement", "mass", "stability")
        )
    )


def _bits(weights: NDArray[Any]) -> NDArray[Any]:
    """Return weights as whole numbers, in the same order."""
    return weights if weights.dtype == np.uint8 else weights.view(np.uint16)
