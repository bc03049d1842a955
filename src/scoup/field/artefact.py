"""The ``.scoup`` file: a language field as safetensors with a JSON header (docs/formats.md)."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup.base.atomic import atomic_path, check_output
from scoup.base.digests import array_checksum, sealed
from scoup.base.errors import InputError, WriteError, check_format_version
from scoup.field.container import (
    METADATA_KEY,
    SCHEMA,
    VERSION,
    check_sums,
    field_damage_named,
    place_of,
    read_container,
    relative_place,
)
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.field_info import FieldInfo
from scoup.scene.gaussians import Gaussians
from scoup.scene.things import MOST_THINGS, NO_THING, ThingTable

_GEOMETRY = ("means", "quats", "scales", "opacities", "sh")


@dataclass(frozen=True, eq=False)
class FieldParts:
    """Everything a ``.scoup`` file holds; attributes as those of ``LanguageField``.

    ``gaussians`` are those embedded in the file, or to be embedded; None for none.
    """

    code_indices: Tensor  # [N, S, K]
    code_weights: Tensor  # [N, S, K]
    codebook: Tensor  # [S, L, D]
    info: FieldInfo
    gaussians: Gaussians | None
    geometry_path: Path | None
    cameras: Cameras | None
    things: ThingTable | None = None


def write_field(parts: FieldParts, path: Path, overwrite: bool, weight_bits: int) -> None:
    """Write a field; see ``LanguageField.save``."""
    if weight_bits not in (8, 16):
        raise InputError(f"code weights must have 8 or 16 bits, got {weight_bits}")
    check_output(path, overwrite)
    weights = parts.code_weights
    if weight_bits == 8:
        # In steps of each code's largest weight, so that no code is rounded away.
        largest = weights.float().amax(-1, keepdim=True).clamp(min=torch.finfo(torch.float16).tiny)
        weights = (weights.float() / largest * 255).round().to(torch.uint8)
    tensors = {"code_indices": parts.code_indices, "code_weights": weights, "codebook": parts.codebook}
    if parts.gaussians is not None:
        tensors |= {f"geometry.{name}": getattr(parts.gaussians, name) for name in _GEOMETRY}
    if parts.cameras is not None:
        tensors |= _camera_tensors(parts.cameras)
    if parts.things is not None:
        tensors |= _thing_tensors(parts.things)
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    header = {
        "schema": SCHEMA,
        "version": VERSION,
        "checksums": {name: tensor_checksum(tensor) for name, tensor in tensors.items()},
        "levels": list(parts.info.levels),
        "embedding_model": parts.info.embedding_model,
        "words": relative_place(path, parts.info.words),
        "raster_preset": parts.info.raster_preset,
        "geometry": {
            "fingerprint": parts.info.fingerprint,
            "n_gaussians": parts.info.n_gaussians,
            "path": relative_place(path, parts.geometry_path),
        },
        "cameras": None if parts.cameras is None else list(parts.cameras.names),
        "provenance": parts.info.provenance,
    }
    # One metadata entry: safetensors writes several in no fixed order, and equal fields must be equal bytes.
    metadata = {METADATA_KEY: sealed(header)}
    with atomic_path(path, overwrite) as temporary:
        _write(temporary, tensors, metadata)


def read_field(path: Path) -> FieldParts:
    """Read what a ``.scoup`` file holds; see ``LanguageField.load``. The parts are not yet checked for sense.

    Everything in the file is read, once: header and tensors, embedded Gaussians included. All of it is compared with
    its checksums before any of it is used.
    """
    text, header, tensors = read_container(path, "pt")
    if "codebook" in tensors:
        # In the file it begins anywhere; products of matrices have the same bytes only with the same alignment.
        tensors["codebook"] = tensors["codebook"].clone()
    with field_damage_named(path):
        check_format_version(path, header["version"], VERSION)
        return _checked_parts(path, text, header, tensors)


def _checked_parts(path: Path, text: str, header: dict[str, Any], tensors: dict[str, Tensor]) -> FieldParts:
    """Return the parts of a file whose checksums all agree."""
    check_sums(path, text, header, {name: tensor.contiguous().numpy() for name, tensor in tensors.items()})
    geometry = header["geometry"]
    info = FieldInfo(
        levels=tuple(str(level) for level in header["levels"]),
        embedding_model=str(header["embedding_model"]),
        fingerprint=str(geometry["fingerprint"]),
        n_gaussians=int(geometry["n_gaussians"]),
        raster_preset=str(header["raster_preset"]),
        provenance=dict(header["provenance"]),
        words=place_of(path, header["words"]),
    )
    weights = tensors["code_weights"]
    if weights.dtype == torch.uint8:
        weights = weights.float() / weights.float().sum(-1, keepdim=True).clamp(min=1)
    elif weights.dtype != torch.float16:
        raise InputError(f"code weights are {weights.dtype}, expected float16 or uint8")
    gaussians = None
    if "geometry.means" in tensors:
        gaussians = Gaussians(*(tensors[f"geometry.{name}"] for name in _GEOMETRY))
    return FieldParts(
        tensors["code_indices"],
        weights,
        tensors["codebook"].float(),
        info,
        gaussians,
        place_of(path, geometry["path"]),
        _cameras(tensors, header["cameras"]),
        _things(tensors),
    )


def tensor_checksum(tensor: Tensor) -> str:
    """Return ``array_checksum`` of a tensor on the CPU."""
    return array_checksum(tensor.contiguous().numpy())


def _write(temporary: Path, tensors: dict[str, Tensor], metadata: dict[str, str]) -> None:
    """Write a safetensors file."""
    from safetensors import SafetensorError
    from safetensors.torch import save_file

    try:
        temporary.touch()
        permissions = temporary.stat().st_mode  # as of any new file; safetensors makes private ones
        save_file(tensors, temporary, metadata)
        temporary.chmod(permissions)
    except OSError as error:
        raise WriteError.of(temporary, error) from error
    except SafetensorError as error:
        # Only the text contains the system's own number: "(os error 28)", or "code: 28" in older versions.
        number = re.search(r"(?:os error|code:) (\d+)", str(error))
        if number is None:
            raise
        code = int(number[1])
        raise WriteError.of(temporary, OSError(code, os.strerror(code))) from error


def _camera_tensors(cameras: Cameras) -> dict[str, Tensor]:
    sizes = [[camera.width, camera.height] for camera in cameras]
    return {
        "cameras.viewmats": torch.stack([camera.viewmat for camera in cameras]),
        "cameras.Ks": torch.stack([camera.K for camera in cameras]),
        "cameras.sizes": torch.tensor(sizes, dtype=torch.int32),
    }


def _things(tensors: dict[str, Tensor]) -> ThingTable | None:
    parts = {
        name.removeprefix("things."): tensor for name, tensor in tensors.items() if name.startswith("things.")
    }
    for name in ("owners", "parents") if parts else ():
        if parts[name].dtype != torch.uint16:
            raise InputError(f"things.{name} is {parts[name].dtype}, expected torch.uint16")
        numbers = parts[name].int()
        parts[name] = torch.where(numbers == MOST_THINGS, NO_THING, numbers)
    return ThingTable(**parts) if parts else None


def _thing_tensors(things: ThingTable) -> dict[str, Tensor]:
    """Return the tensors of things, with numbers of two bytes; the largest means none."""
    tensors = {f"things.{each.name}": getattr(things, each.name) for each in fields(things)}
    for name in ("things.owners", "things.parents"):
        tensors[name] = torch.where(tensors[name] == NO_THING, MOST_THINGS, tensors[name]).to(torch.uint16)
    return tensors


def _cameras(tensors: dict[str, Tensor], names: list[str] | None) -> Cameras | None:
    if names is None:
        return None
    parts = (tensors["cameras.viewmats"], tensors["cameras.Ks"], tensors["cameras.sizes"].tolist())
    return Cameras(
        Camera(str(name), viewmat, K, int(size[0]), int(size[1]))
        for name, viewmat, K, size in zip(names, *parts, strict=True)
    )
