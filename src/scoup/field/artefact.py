"""The ``.scoup`` file: a language field as safetensors with a JSON header (docs/formats.md)."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup.base.atomic import atomic_path, check_output
from scoup.base.errors import FileFormatError, InputError, MissingFileError
from scoup.io.reading import safetensors_damage_named
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import index_dtype
from scoup.scene.gaussians import Gaussians

SCHEMA = "scoup.language_field"
VERSION = 1
METADATA_KEY = "scoup"
_GEOMETRY = ("means", "quats", "scales", "opacities", "sh")
_REBUILD = "build the field again, or copy the file again if it was cut short"


@dataclass(frozen=True)
class FieldInfo:
    """What a field is, without its tensors.

    Attributes:
        levels: level names, fine to coarse.
        embedding_model: id of the model whose embeddings were coded; queries must come from the same model.
        fingerprint: of the geometry the field belongs to (``Gaussians.fingerprint``).
        n_gaussians: N of that geometry.
        raster_preset: rasteriser constants the field was built with and is rendered with.
        provenance: software version, settings, source hashes, coding reports; plain JSON values.
    """

    levels: tuple[str, ...]
    embedding_model: str
    fingerprint: str
    n_gaussians: int
    raster_preset: str = "inria"
    provenance: dict[str, Any] = field(default_factory=dict)


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


def check_codes(code_indices: Tensor, code_weights: Tensor, codebook: Tensor, info: FieldInfo) -> None:
    """Check the codes of a field; see ``LanguageField``.

    Raises:
        InputError: shapes, dtypes or values do not fit together.
    """
    shape = tuple(code_indices.shape)
    if len(shape) != 3 or shape != tuple(code_weights.shape) or shape[0] != info.n_gaussians:
        raise InputError(
            f"code indices {list(shape)} and weights {list(code_weights.shape)} must both be "
            f"[{info.n_gaussians}, S, K]"
        )
    if codebook.dim() != 3 or not len(codebook) == shape[1] == len(info.levels):
        raise InputError(
            f"codebook {list(codebook.shape)} does not fit {shape[1]} levels of codes and "
            f"{len(info.levels)} level names"
        )
    n_atoms = codebook.shape[1]
    if code_indices.dtype != index_dtype(n_atoms):
        raise InputError(f"code indices are {code_indices.dtype}, expected {index_dtype(n_atoms)}")
    # The smallest and the largest are not finite if any is not, and need no copy of the weights.
    low, high = torch.aminmax(code_weights) if code_weights.numel() else torch.zeros(2)
    if not torch.isfinite(codebook).all() or not bool(torch.isfinite(low) & torch.isfinite(high)):
        raise InputError("codebook or code weights hold values that are not finite")
    if low < 0:
        raise InputError("a code weight is negative")
    # torch finds no largest of uint16.
    indices = code_indices if code_indices.dtype == torch.uint8 else code_indices.int()
    if indices.numel() and int(indices.max()) >= n_atoms:
        raise InputError(f"a code index is beyond the {n_atoms} atoms of the codebook")


def write_field(parts: FieldParts, path: Path, overwrite: bool, weight_bits: int) -> None:
    """Write a field; see ``LanguageField.save``."""
    if weight_bits not in (8, 16):
        raise InputError(f"weights are stored with 8 or 16 bits, not {weight_bits}")
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
    header = {
        "levels": list(parts.info.levels),
        "embedding_model": parts.info.embedding_model,
        "raster_preset": parts.info.raster_preset,
        "geometry": {
            "fingerprint": parts.info.fingerprint,
            "n_gaussians": parts.info.n_gaussians,
            "path": None if parts.geometry_path is None else _relative(parts.geometry_path, path),
        },
        "cameras": None if parts.cameras is None else list(parts.cameras.names),
        "provenance": parts.info.provenance,
    }
    with atomic_path(path, overwrite) as temporary:
        _write(path, temporary, tensors, SCHEMA, header)


def read_field(path: Path) -> FieldParts:
    """Read what a ``.scoup`` file holds; see ``LanguageField.load``. The parts are not yet checked for sense.

    Raises:
        MissingFileError, FileFormatError: it is not there, or no language field.
    """
    tensors, header = read_tensors(path, SCHEMA, "a SCOUP language field")
    with field_damage_named(path):
        geometry = header["geometry"]
        info = FieldInfo(
            levels=tuple(str(level) for level in header["levels"]),
            embedding_model=str(header["embedding_model"]),
            fingerprint=str(geometry["fingerprint"]),
            n_gaussians=int(geometry["n_gaussians"]),
            raster_preset=str(header["raster_preset"]),
            provenance=dict(header["provenance"]),
        )
        geometry_path = geometry["path"]
        if geometry_path is not None:
            geometry_path = Path(os.path.normpath(path.absolute().parent / str(geometry_path)))
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
            geometry_path,
            _cameras(tensors, header["cameras"]),
        )


@contextmanager
def field_damage_named(path: Path) -> Iterator[None]:
    """Failures while putting a field together become one FileFormatError that names the file."""
    try:
        yield
    except FileFormatError:
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(path, f"is not a complete language field ({reason})", _REBUILD) from error


def read_tensors(path: Path, schema: str, what: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """All tensors and the JSON header of a safetensors file of ours.

    Raises:
        FileFormatError: it is something else, damaged, or of a newer version.
    """
    from safetensors import safe_open

    if path.is_dir():
        raise MissingFileError(path, f"is a folder, not {what}", "give the file itself")
    if not path.is_file():
        raise MissingFileError(path, f"there is no such file ({what} was expected)", "check the path")
    with safetensors_damage_named(path, what, _REBUILD), safe_open(path, framework="pt") as stream:
        header = json.loads((stream.metadata() or {}).get(METADATA_KEY, "{}"))
        if not isinstance(header, dict) or header.get("schema") != schema:
            raise FileFormatError(path, f"is a safetensors file, but not {what}", "check the path")
        version = int(header["version"])
        if version > VERSION:
            raise FileFormatError(
                path, f"was written by a newer SCOUP (format {version})", "pip install -U scoup"
            )
        return {name: stream.get_tensor(name) for name in stream.keys()}, header  # noqa: SIM118


def _write(
    path: Path, temporary: Path, tensors: dict[str, Tensor], schema: str, header: dict[str, Any]
) -> None:
    """Write what will become ``path`` to ``temporary``."""
    from safetensors.torch import save_file

    # One metadata entry: safetensors writes several in no fixed order, and equal fields must be equal bytes.
    metadata = {METADATA_KEY: json.dumps({"schema": schema, "version": VERSION, **header}, sort_keys=True)}
    try:
        temporary.touch(exist_ok=False)
        permissions = temporary.stat().st_mode  # as of any new file; safetensors makes private ones
        save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, temporary, metadata)
        temporary.chmod(permissions)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error


def _camera_tensors(cameras: Cameras) -> dict[str, Tensor]:
    sizes = [[camera.width, camera.height] for camera in cameras]
    return {
        "cameras.viewmats": torch.stack([camera.viewmat for camera in cameras]),
        "cameras.Ks": torch.stack([camera.K for camera in cameras]),
        "cameras.sizes": torch.tensor(sizes, dtype=torch.int32),
    }


def _cameras(tensors: dict[str, Tensor], names: list[str] | None) -> Cameras | None:
    if names is None:
        return None
    parts = (tensors["cameras.viewmats"], tensors["cameras.Ks"], tensors["cameras.sizes"].tolist())
    return Cameras(
        Camera(str(name), viewmat, K, int(size[0]), int(size[1]))
        for name, viewmat, K, size in zip(names, *parts, strict=True)
    )


def _relative(target: Path, artefact: Path) -> str:
    try:
        return Path(os.path.relpath(target.absolute(), artefact.absolute().parent)).as_posix()
    except ValueError:  # another drive on Windows
        return target.absolute().as_posix()
