"""The ``.scoup`` file: a language field as safetensors with a JSON header (docs/formats.md)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from scoup.base import InputError, SealedFile, WorldFrame, check_output
from scoup.field.checks import MOST_THINGS
from scoup.field.container import (
    SCHEMA,
    VERSION,
    place_of,
    read_content,
    relative_place,
)
from scoup.field.field_info import FieldInfo
from scoup.field.thing_table import NO_THING, TENSORS, NameTable, ThingTable
from scoup.scene import Camera, Cameras, Gaussians

if TYPE_CHECKING:
    from scoup.field.field import Field

_GEOMETRY = ("means", "quats", "scales", "opacities", "sh")
_NAMES = ("presence", "rows", "things", "votes")


def write_field(field: Field, path: Path, overwrite: bool, embed_geometry: bool, weight_bits: int) -> None:
    """Write a field; see ``LanguageField.save``."""
    if weight_bits not in (8, 16):
        raise InputError(f"code weights must have 8 or 16 bits, got {weight_bits}")
    check_output(path, overwrite=overwrite)
    info, weights, things = field.info, field.code_weights, field.thing_table
    if weight_bits == 8:
        # In steps of each code's largest weight, so that no code is rounded away.
        largest = weights.float().amax(-1, keepdim=True).clamp(min=torch.finfo(torch.float16).tiny)
        weights = (weights.float() / largest * 255).round().to(torch.uint8)
    tensors = {"code_indices": field.code_indices, "code_weights": weights, "codebook": field.codebook}
    if embed_geometry:
        tensors |= {f"geometry.{name}": getattr(field.gaussians, name) for name in _GEOMETRY}
    if field.cameras is not None:
        tensors |= _camera_tensors(field.cameras)
    if things is not None:
        tensors |= _thing_tensors(things)
    names = None if things is None else things.names
    if names is not None:
        tensors |= {f"names.{name}": getattr(names, name) for name in _NAMES}
    arrays = {name: tensor.detach().cpu().contiguous().numpy() for name, tensor in tensors.items()}
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "levels": list(info.levels),
        "embedding_model": info.embedding_model,
        "words": relative_place(path, info.words),
        "raster_preset": info.raster_preset,
        "geometry": {
            "fingerprint": info.fingerprint,
            "n_gaussians": info.n_gaussians,
            "path": relative_place(path, field.geometry_path),
        },
        "cameras": None if field.cameras is None else list(field.cameras.names),
        "provenance": info.provenance,
        **({} if names is None else {"names": list(names.texts)}),
        **info.world.entry(),
    }
    SealedFile.write(path, header, arrays, overwrite)


def read_field(path: Path) -> tuple[dict[str, Any], Gaussians | None]:
    """Return the arguments of a field from its file, and the Gaussians embedded in it; see ``LanguageField.load``.

    Everything in the file is read, once, and checked before any of it is used (``container.read_content``).
    """
    header, arrays = read_content(path)
    geometry = header["geometry"]
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    info = FieldInfo(
        levels=tuple(header["levels"]),
        embedding_model=header["embedding_model"],
        fingerprint=geometry["fingerprint"],
        n_gaussians=geometry["n_gaussians"],
        raster_preset=header["raster_preset"],
        provenance=header["provenance"],
        words=place_of(path, header["words"]),
        world=WorldFrame.of_header(header),
    )
    weights = tensors["code_weights"]
    if weights.dtype == torch.uint8:
        weights = weights.float() / weights.float().sum(-1, keepdim=True).clamp(min=1)
    gaussians = None
    if "geometry.means" in tensors:
        gaussians = Gaussians(*(tensors[f"geometry.{name}"] for name in _GEOMETRY))
    arguments = {
        "code_indices": tensors["code_indices"],
        "code_weights": weights,
        # The file does not align it; matrix products have the same bytes only with the same alignment.
        "codebook": tensors["codebook"].clone().float(),
        "info": info,
        "geometry_path": place_of(path, geometry["path"]),
        "cameras": _cameras(tensors, header["cameras"]),
        "thing_table": _things(tensors, header.get("names")),
    }
    return arguments, gaussians


def _camera_tensors(cameras: Cameras) -> dict[str, Tensor]:
    sizes = [[camera.width, camera.height] for camera in cameras]
    return {
        "cameras.viewmats": torch.stack([camera.viewmat for camera in cameras]),
        "cameras.Ks": torch.stack([camera.K for camera in cameras]),
        "cameras.sizes": torch.tensor(sizes, dtype=torch.int32),
    }


def _things(tensors: dict[str, Tensor], names: list[str] | None) -> ThingTable | None:
    if "things.owners" not in tensors:
        return None
    parts = {name: tensors[f"things.{name}"] for name in TENSORS}
    for name in ("owners", "parents"):
        numbers = parts[name].int()
        parts[name] = torch.where(numbers == MOST_THINGS, NO_THING, numbers)
    named = None if names is None else NameTable(tuple(names), *(tensors[f"names.{part}"] for part in _NAMES))
    return ThingTable(**parts, names=named)


def _thing_tensors(things: ThingTable) -> dict[str, Tensor]:
    """Return the tensors of things, with numbers of two bytes; the largest means none."""
    tensors = {f"things.{name}": getattr(things, name) for name in TENSORS}
    for name in ("things.owners", "things.parents"):
        tensors[name] = torch.where(tensors[name] == NO_THING, MOST_THINGS, tensors[name]).to(torch.uint16)
    return tensors


def _cameras(tensors: dict[str, Tensor], names: list[str] | None) -> Cameras | None:
    if names is None:
        return None
    parts = (tensors["cameras.viewmats"], tensors["cameras.Ks"], tensors["cameras.sizes"].tolist())
    return Cameras(
        Camera(name, viewmat, K, width, height)
        for name, viewmat, K, (width, height) in zip(names, *parts, strict=True)
    )
