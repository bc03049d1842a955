"""Files of language fields, taken apart and put together."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from scoup.base.digests import sealed
from scoup.field.artefact import tensor_checksum
from scoup.field.container import METADATA_KEY


def parts_of(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The JSON header and the tensors of a file."""
    with safe_open(path, framework="pt") as stream:
        tensors = {name: stream.get_tensor(name).clone() for name in stream.keys()}  # noqa: SIM118
        return json.loads(stream.metadata()[METADATA_KEY]), tensors


def write_parts(path: Path, header: Mapping[str, Any], tensors: dict[str, Tensor]) -> None:
    """A file with this very header, and so with its checksums."""
    save_file(tensors, path, {METADATA_KEY: json.dumps(header, sort_keys=True)})


def write_whole(path: Path, header: Mapping[str, Any], tensors: dict[str, Tensor]) -> None:
    """A file whose checksums are right, whatever it contains."""
    checksums = {name: tensor_checksum(tensor) for name, tensor in tensors.items()}
    save_file(tensors, path, {METADATA_KEY: sealed({**header, "checksums": checksums})})
