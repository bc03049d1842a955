"""Relevancy maps of labelled frames, predicted once and kept: rules and tables can then be tried as often as one likes.

A map is found again by everything it depends on (field, camera, words, size), never by its place alone. Maps are kept
as float32, so that scores from the cache are those without it, ties included: about 9 MB a label and frame at the
size of LERF-OVS. Delete the folder to be rid of it.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file, save
from torch import Tensor

from scoup.io import atomic_file
from scoup.scene.cameras import Camera

VERSION = 1
_DIGITS = 16


def kept_map(folder: Path, name: str, key: str, predict: Callable[[], Tensor]) -> Tensor:
    """Return a map from a folder, or from ``predict``, which is then kept there.

    ``key``: from ``prediction_key``.
    """
    path = folder / f"{name}_{key[:_DIGITS]}.safetensors"
    with suppress(SafetensorError, OSError, ValueError, LookupError):  # a damaged file is made again
        return load_file(path)["relevancy"]
    relevancy = predict().float().cpu().contiguous()
    with atomic_file(path, overwrite=True) as stream:
        stream.write(save({"relevancy": relevancy}, {"key": key, "name": name}))
    return relevancy


def prediction_key(
    source: str,
    camera: Camera,
    labels: Sequence[str],
    vectors: Tensor,
    canonical: Tensor,
    size: tuple[int, int],
) -> str:
    """Return SHA-256 of all that a map depends on.

    ``source``: digest of the field (``file_sha256``), or of whatever else gives the maps; ``vectors``,
    ``canonical``: [Q, D] and [P, D] of the words.
    """
    described = {
        "version": VERSION,
        "source": source,
        "camera": [camera.viewmat.tolist(), camera.K.tolist(), camera.width, camera.height],
        "labels": list(labels),
        "words": [tensor_digest(vectors), tensor_digest(canonical)],
        "size": list(size),
    }
    return hashlib.sha256(json.dumps(described).encode()).hexdigest()


def tensor_digest(tensor: Tensor) -> str:
    """Return SHA-256 of the values of a tensor, as float32."""
    values = tensor.detach().cpu().to(torch.float32).contiguous()
    return hashlib.sha256(str(list(values.shape)).encode() + values.numpy().tobytes()).hexdigest()
