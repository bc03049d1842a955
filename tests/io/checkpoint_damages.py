"""Damaged checkpoints: a table for the test of damage."""

from __future__ import annotations

import pickle
import re
import zipfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import torch
from splat_damages import Kind, written
from torch import nn

from foreign_samples import captured, save_splatfacto
from io_samples import save_checkpoint, some_gaussians
from scoup.io import load_gaussians
from scoup.io.langsplat_checkpoint import read_langsplat
from scoup.io.regions.langsplat_autoencoder import read_autoencoder


class Runs:
    """Is not to be run by reading."""

    def __reduce__(self) -> Any:
        return print, ("this was run",)


def torch_file(name: str, folder: Path, content: Any) -> Path:
    torch.save(content, folder / name)
    return folder / name


def pickled(folder: Path, content: bytes) -> Path:
    """A checkpoint whose pickle is another."""
    path = folder / "a.pt"
    torch_file("valid.pt", folder, {"a": torch.zeros(4)})
    with zipfile.ZipFile(folder / "valid.pt") as valid, zipfile.ZipFile(path, "w") as made:
        for entry in valid.infolist():
            ours = entry.filename.endswith("data.pkl")
            made.writestr(entry.filename, content if ours else valid.read(entry))
    return path


def claiming_entries(folder: Path) -> Path:
    """Entries of an archive that claim more bytes than there are: packed, and unpacked as before."""
    content = bytearray(pickled(folder, b"\x80\x02}.").read_bytes())
    for entry in [found.start() for found in re.finditer(b"PK\1\2", content)]:
        content[entry + 20 : entry + 24] = (2**31 - 1).to_bytes(4, "little")
    return written("a.pt", folder, bytes(content))


def makes_memory(name: bytes) -> Callable[[Path], Path]:
    """A pickle that asks for any amount of memory."""
    call = b"\x80\x02c" + name + b"\n\x8a\x05" + (10**10).to_bytes(5, "little") + b"\x85R."
    return lambda folder: pickled(folder, call)


def splats(**changes: Any) -> Callable[[Path], Path]:
    return lambda folder: save_checkpoint(some_gaussians(4), folder / "a.pt", **changes)


def content(value: Any) -> Callable[[Path], Path]:
    return partial(torch_file, "a.pt", content=value)


CLAIMED = {"means": torch.zeros(1).expand(10**9, 3), "quats": torch.zeros(1).expand(10**9, 4)}
GSPLAT: dict[str, Callable[[Path], Path]] = {
    "model": content({"model": 1}), "list": content([1, 2]), "number": content({"splats": 3}),
    "means alone": content({"splats": {"means": torch.zeros(2, 3)}}), "objects": content({"splats": Runs()}),
    "bare": lambda folder: written("a.pt", folder, pickle.dumps({"splats": 1})), "entries": claiming_entries,
    "columns": splats(quats=torch.zeros(4, 3)), "rows": splats(scales=torch.zeros(3, 3)),
    "integers": splats(means=torch.zeros(4, 3, dtype=torch.int64)), "claimed": splats(**CLAIMED),
    "degree": splats(shN=torch.zeros(4, 4, 3)),
    **{name.decode().replace("\n", "."): makes_memory(name) for name in (
        b"builtins\nbytearray", b"torch\nFloatTensor", b"torch\nTensor", b"torch.storage\nUntypedStorage",
        b"torch.sparse\nFloatTensor")},
}  # fmt: skip


def damaged_splatfacto(folder: Path, changes: dict[str, Any] | None) -> Path:
    path = folder / "step-000000009.ckpt"
    save_splatfacto(some_gaussians(9, 0), path)
    valid = torch.load(path, weights_only=True)["pipeline"]
    return torch_file(path.name, folder, {"pipeline": None if changes is None else {**valid, **changes}})


def damaged_langsplat(folder: Path, damage: tuple[slice, list[Any]]) -> Path:
    entries = list(captured(some_gaussians(7, 1))[0])
    entries[damage[0]] = damage[1]
    return torch_file("a.pth", folder, (tuple(entries), 10000))




LANGSPLAT = {
    name: (slice(place, place + 1), [value]) for name, place, value in (
        ("features", 1, torch.zeros(6, 3)), ("logits", 7, torch.zeros(7, 9)), ("codebooks", 8, torch.zeros(8, 16)),
        ("nan", 8, torch.full((1, 8, 16), torch.nan)), ("claimed", 1, torch.zeros(1, 1).expand(10**9, 3)),
        ("text", 4, "scales"), ("objects", 13, Runs()),
    )
} | {"no features": (slice(7, 9), []), "five": (slice(5, None), [])}  # fmt: skip
AUTOENCODER = {
    "encoder": {"encoder.0.weight": torch.zeros(3, 3)}, "bias": {"decoder.0.weight": torch.zeros(3, 3)},
    "sizes": {"decoder.0.weight": torch.zeros(4, 3), "decoder.0.bias": torch.zeros(4),
              "decoder.2.weight": torch.zeros(5, 9), "decoder.2.bias": torch.zeros(5)},
    "list": [1, 2], "objects": nn.Linear(2, 2),
}  # fmt: skip

SPLATFACTO = {"scales": {"_model.gauss_params.scales": torch.zeros(8, 3)}, "pipeline": None}
KINDS = {
    "gsplat": Kind(lambda folder, make: make(folder), load_gaussians, GSPLAT),
    "nerfstudio": Kind(damaged_splatfacto, load_gaussians, SPLATFACTO),
    "LangSplatV2": Kind(damaged_langsplat, read_langsplat, LANGSPLAT),
    "autoencoder": Kind(partial(torch_file, "a.pth"), read_autoencoder, AUTOENCODER),
}
