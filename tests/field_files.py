"""A small field without anything random, and files of language fields, taken apart and put together."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from scoup.base.sealed_file import KEY as METADATA_KEY
from scoup.base.sealed_file import array_checksum, sealed
from scoup.field import FieldInfo, ThingTable
from scoup.field.thing_table import TENSORS
from scoup.query import LanguageField
from scoup.scene import Camera, Cameras, Gaussians

COUNT, LEVELS, K, ATOMS, DIM = 6, 3, 2, 4, 8


def steps(*shape: int) -> torch.Tensor:
    """Numbers from 0 to below 1, rising, as float32."""
    count = int(torch.tensor(shape).prod())
    return (torch.arange(count, dtype=torch.float32) / count).reshape(shape)


def small_field() -> LanguageField:
    """Six Gaussians, three levels, two cameras; the same on every machine."""
    quats = torch.zeros(COUNT, 4)
    quats[:, 0] = 1
    gaussians = Gaussians(
        steps(COUNT, 3), quats, steps(COUNT, 3) + 0.125, steps(COUNT) / 2 + 0.25, steps(COUNT, 1, 3) - 0.5
    )
    K_matrix = torch.tensor([[40.0, 0, 20], [0, 40.0, 15], [0, 0, 1]], dtype=torch.float64)
    viewmats = [torch.eye(4, dtype=torch.float64) for _ in range(2)]
    viewmats[1][2, 3] = 0.5
    cameras = Cameras(
        Camera(f"view {number}.png", viewmat, K_matrix, 40, 30) for number, viewmat in enumerate(viewmats)
    )
    first = torch.arange(COUNT * LEVELS).reshape(COUNT, LEVELS, 1) % ATOMS
    indices = torch.cat([first, (first + 1) % ATOMS], -1).to(torch.uint8)
    weights = torch.tensor([0.75, 0.25], dtype=torch.float16).expand(COUNT, LEVELS, K).clone()
    weights[-1] = 0  # a Gaussian without a code
    codebook = steps(LEVELS, ATOMS, DIM) + 0.5
    made_with = {"settings": {"k": K, "share": 0.1}}
    info = FieldInfo(("s", "m", "l"), "a/model é", gaussians.fingerprint(), COUNT, "inria", made_with)
    return LanguageField(indices, weights, codebook, info, gaussians, Path("somewhere/splat.ply"), cameras)


def check_same_things(one: ThingTable | None, other: ThingTable | None) -> None:
    """Equal in every number, and in the names."""
    for name in TENSORS:
        mine, theirs = getattr(one, name), getattr(other, name)
        assert mine.dtype == theirs.dtype
        assert mine.equal(theirs), name
    names = [getattr(getattr(each, "names", None), "texts", ()) for each in (one, other)]
    assert names[0] == names[1]


def parts_of(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    """The JSON header and the tensors of a file."""
    with safe_open(path, framework="pt") as stream:
        tensors = {name: stream.get_tensor(name).clone() for name in stream.keys()}  # noqa: SIM118
        return json.loads(stream.metadata()[METADATA_KEY]), tensors


def write_parts(path: Path, header: Mapping[str, Any], tensors: dict[str, Tensor]) -> None:
    """A file with this very header, and so with its checksums."""
    save_file(tensors, path, {METADATA_KEY: json.dumps(header, sort_keys=True)})


def tensor_checksum(tensor: Tensor) -> str:
    """As a header has it."""
    return array_checksum(tensor.contiguous().numpy())


def write_whole(path: Path, header: Mapping[str, Any], tensors: dict[str, Tensor]) -> None:
    """A file whose checksums are right, whatever it contains."""
    checksums = {name: tensor_checksum(tensor) for name, tensor in tensors.items()}
    save_file(tensors, path, {METADATA_KEY: sealed({**header, "checksums": checksums})})
