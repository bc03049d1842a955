"""Work in progress on the views of a splat: chosen cameras and finished renders, which an interrupted run keeps."""

from __future__ import annotations

import hashlib
import json
import warnings
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base.atomic import remove
from scoup.base.digests import array_checksum
from scoup.base.errors import ScoupWarning
from scoup.base.locks import locked_output
from scoup.base.npz import write_npz
from scoup.io import save_png
from scoup.io.images import open_image
from scoup.pictures.colors import Picture
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians

VERSION = 1
STATE = "state.npz"


@dataclass
class ViewWork:
    """The folder OUT.partial, or nothing on disk: then only counts."""

    seen: Tensor
    """[N] int32, in how many of the first ``done`` views each Gaussian is."""
    path: Path | None = None
    of: str = ""
    """Digest of what the views are of, and how they are chosen."""
    done: int = 0
    """Views that are kept."""
    cameras: Cameras = field(default_factory=lambda: Cameras(()))
    """Chosen; empty before."""

    def choose(self, cameras: Cameras) -> Cameras:
        """Keep cameras that were chosen; returns them."""
        self.cameras = cameras
        self._save()
        return cameras

    def picture(self, name: str) -> Picture:
        """Return a kept render."""
        assert self.path is not None
        with open_image(self.path / name) as image:
            return np.asarray(image)

    def keep(self, gaussians: Tensor, name: str = "", picture: Picture | None = None) -> None:
        """Keep a finished view, by the numbers of the Gaussians in it, and its render unless it is a photograph."""
        self.seen[gaussians] += 1
        self.done += 1
        if self.path is not None and picture is not None:
            save_png(picture, self.path / name, overwrite=True)
        self._save()

    def _save(self) -> None:
        if self.path is None:
            return
        arrays = {
            "of": np.array(self.of),
            "done": np.array(self.done),
            "seen": self.seen.numpy(),
            "names": np.array(self.cameras.names),
            "sizes": np.array([(camera.width, camera.height) for camera in self.cameras]),
            "poses": np.stack([camera.viewmat.numpy() for camera in self.cameras]),
            "lenses": np.stack([camera.K.numpy() for camera in self.cameras]),
        }
        write_npz(self.path / STATE, arrays, overwrite=True)


@contextmanager
def view_work(out: Path, gaussians: Gaussians, beside: Cameras | None, **how: Any) -> Iterator[ViewWork]:
    """Keep the work on the views of a scene in the folder OUT.partial, and continue that of an interrupted run.

    At the end of the block the folder is removed; after an error it stays for the next run with the same splat,
    photographs and ``how``, JSON values. Other processes are kept from writing views of the scene.
    """
    path = out.with_name(f"{out.name}.partial")
    there = [(camera.name, camera.fingerprint()) for camera in beside or ()]
    of_splat = [gaussians.fingerprint(), array_checksum(gaussians.sh.numpy())]
    text = json.dumps([VERSION, of_splat, there, how], sort_keys=True)
    of = hashlib.sha256(text.encode()).hexdigest()
    with locked_output(path, overwrite=True, is_folder=True):
        work = _open(path, of, len(gaussians))
        if work is None and path.exists():
            warnings.warn(f"{path}: belongs to other views; starting over", ScoupWarning, stacklevel=3)
            remove(path)
        yield work or ViewWork(torch.zeros(len(gaussians), dtype=torch.int32), path, of)
        remove(path)


def _open(path: Path, of: str, n_gaussians: int) -> ViewWork | None:
    """Return the work of an interrupted run; None if there is none, or of other views, or it is damaged."""
    try:
        with np.load(path / STATE, allow_pickle=False) as kept:
            if str(kept["of"]) != of or kept["seen"].shape != (n_gaussians,):
                return None
            rows = (kept[name].tolist() for name in ("names", "poses", "lenses", "sizes"))
            cameras = Cameras(
                Camera(name, pose, lens, *size) for name, pose, lens, size in zip(*rows, strict=True)
            )
            return ViewWork(torch.from_numpy(kept["seen"]), path, of, int(kept["done"]), cameras)
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None
