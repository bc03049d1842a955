"""The ``.scoup`` file: a language field as safetensors with a JSON header (docs/formats.md)."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup.cameras import Camera, Cameras
from scoup.errors import FileFormatError, InputError, MissingFileError, ScoupError
from scoup.field import FieldInfo, LanguageField
from scoup.gaussians import Gaussians
from scoup.io.atomic import atomic_path, check_output

SCHEMA = "scoup.language_field"
VERSION = 1
METADATA_KEY = "scoup"
_GEOMETRY = ("means", "quats", "scales", "opacities", "sh")
_REBUILD = "build the field again, or copy the file again if it was cut short"


def save_field(
    field: LanguageField, path: Path, overwrite: bool, embed_geometry: bool, weight_bits: int
) -> None:
    """See ``LanguageField.save``."""
    if weight_bits not in (8, 16):
        raise InputError(f"weights are stored with 8 or 16 bits, not {weight_bits}")
    siblings = accumulators_path(path)
    check_output(path, overwrite)
    if field.accumulators is not None:
        check_output(siblings, overwrite)
    weights = field.code_weights
    if weight_bits == 8:
        weights = (weights.float() * 255).round().to(torch.uint8)
    tensors = {"code_indices": field.code_indices, "code_weights": weights, "codebook": field.codebook}
    if embed_geometry:
        tensors |= {f"geometry.{name}": getattr(field.gaussians, name) for name in _GEOMETRY}
    if field.cameras is not None:
        tensors |= _camera_tensors(field.cameras)
    header = {
        "levels": list(field.levels),
        "embedding_model": field.info.embedding_model,
        "raster_preset": field.info.raster_preset,
        "geometry": {
            "fingerprint": field.info.fingerprint,
            "n_gaussians": field.info.n_gaussians,
            "path": None if field.geometry_path is None else _relative(field.geometry_path, path),
        },
        "cameras": None if field.cameras is None else list(field.cameras.names),
        "provenance": field.info.provenance,
    }
    if field.accumulators is not None:
        reference = {"fingerprint": field.info.fingerprint}
        _write(siblings, {"accumulators": field.accumulators}, "scoup.accumulators", reference, overwrite)
    _write(path, tensors, SCHEMA, header, overwrite)


def load_field(path: Path, gaussians: Gaussians | None) -> LanguageField:
    """See ``LanguageField.load``."""
    tensors, header = read_tensors(path, SCHEMA, "a SCOUP language field")
    try:
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
            weights = weights.float() / 255
        elif weights.dtype != torch.float16:
            raise InputError(f"code weights are {weights.dtype}, expected float16 or uint8")
        accumulators = _load_accumulators(path, info, tensors["codebook"])
        field = LanguageField(
            tensors["code_indices"],
            weights,
            tensors["codebook"].float(),
            info,
            None,
            geometry_path,
            accumulators,
            _cameras(tensors, header["cameras"]),
        )
        if gaussians is None and "geometry.means" in tensors:
            gaussians = Gaussians(*(tensors[f"geometry.{name}"] for name in _GEOMETRY))
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(path, f"is not a complete language field ({reason})", _REBUILD) from error
    if gaussians is not None:
        field.attach(gaussians, f"{path} with the Gaussians given")
    return field


def accumulators_path(path: Path) -> Path:
    """The sibling file with the float accumulators."""
    return path.with_name(path.name + ".accumulators")


def read_tensors(path: Path, schema: str, what: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """All tensors and the JSON header of a safetensors file of ours.

    Raises:
        FileFormatError: it is something else, damaged, or of a newer version.
    """
    from safetensors import SafetensorError, safe_open

    if not path.is_file():
        raise MissingFileError(path, f"there is no such file ({what} was expected)", "check the path")
    try:
        with safe_open(path, framework="pt") as stream:
            header = json.loads((stream.metadata() or {}).get(METADATA_KEY, "{}"))
            if not isinstance(header, dict) or header.get("schema") != schema:
                raise FileFormatError(path, f"is a safetensors file, but not {what}", "check the path")
            version = int(header["version"])
            if version > VERSION:
                raise FileFormatError(
                    path, f"was written by a newer SCOUP (format {version})", "pip install -U scoup"
                )
            return {name: stream.get_tensor(name) for name in stream.keys()}, header  # noqa: SIM118
    except ScoupError:
        raise
    except (
        SafetensorError,
        ValueError,
        KeyError,
        TypeError,
        OSError,
        RuntimeError,
        OverflowError,
        RecursionError,
    ) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(path, f"is not {what} or is damaged ({reason})", _REBUILD) from error


def _load_accumulators(path: Path, info: FieldInfo, codebook: Tensor) -> Tensor | None:
    sibling = accumulators_path(path)
    if not sibling.is_file():
        return None
    tensors, header = read_tensors(sibling, "scoup.accumulators", "the accumulators of a language field")
    accumulators = tensors.get("accumulators")
    shape = (info.n_gaussians, len(info.levels), codebook.shape[1])
    if (
        accumulators is None
        or tuple(accumulators.shape) != shape
        or header.get("fingerprint") != info.fingerprint
    ):
        raise FileFormatError(
            sibling, f"does not belong to {path.name}", "delete it, or build the field again"
        )
    return accumulators


def _write(
    path: Path, tensors: dict[str, Tensor], schema: str, header: dict[str, Any], overwrite: bool
) -> None:
    from safetensors.torch import save_file

    # One metadata entry: safetensors writes several in no fixed order, and equal fields must be equal bytes.
    metadata = {METADATA_KEY: json.dumps({"schema": schema, "version": VERSION, **header}, sort_keys=True)}
    with atomic_path(path, overwrite) as temporary:
        try:
            temporary.touch(exist_ok=False)
            permissions = temporary.stat().st_mode  # as of any new file; safetensors makes private ones
            save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, temporary, metadata)
            temporary.chmod(permissions)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({error.strerror or error})") from error


def write_tensors(path: Path, tensors: dict[str, Tensor], schema: str, header: dict[str, Any]) -> None:
    """Write a safetensors file of ours atomically, replacing what is there."""
    _write(path, tensors, schema, header, overwrite=True)


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
