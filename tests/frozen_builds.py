"""Builds whose results were frozen before region sums were made once, and what is kept of them.

    python tests/frozen_builds.py FOLDER    # writes room.npz, and kitchen.npz where the real data are at hand

Both files of tests/frozen were written with the code of commit e966596. Run it only to freeze the present state on
purpose: the tests then hold later code to it.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import numpy as np
import torch

import scoup
from children import finished
from scoup.uplift.build_settings import build_settings
from scoup_lab.bench import random_scene_cameras, random_scene_gaussians, random_scene_regions

EPOCHS = 0
"""Of the paper preset's solver, which is not what is frozen: steps of Adam amplify the last bits in which processors
differ, until other atoms are kept."""
FIRST_DEFAULT = {"n_atoms": 128, "k": 4, "keep": 4, "solver": "exact", "effort": "best"}
"""What "default" was when the files were written."""
BUILDS = {
    "default, two rounds": {"settings": "default", **FIRST_DEFAULT, "rounds": 2},
    "default, one round": {"settings": "default", **FIRST_DEFAULT, "rounds": 1},
    "paper, one round": {"settings": "paper", "rounds": 1, "epochs": EPOCHS},
    "paper, two rounds": {"settings": "paper", "rounds": 2, "epochs": EPOCHS},
}


def build(name: str, gaussians, cameras, regions, **more) -> scoup.LanguageField:
    """One of ``BUILDS``."""
    settings = build_settings(**BUILDS[name])
    return scoup.build(gaussians, cameras, regions, settings=settings, **more)


def room():
    """(gaussians, cameras, regions) of a small random scene."""
    cameras = random_scene_cameras(6, 96, 72)
    return (
        random_scene_gaussians(800, seed=3),
        cameras,
        random_scene_regions(cameras, (14, 9, 5), dim=48, seed=3),
    )


def kitchen(folder: Path, features: Path):
    """(gaussians, cameras, regions) of the real kitchen at half size; ``features`` is a folder to write to."""
    script = [sys.executable, folder / "make_langsplat_features.py", folder, "--out", features]
    finished(script, check=True)
    cameras = scoup.load_cameras(folder).scaled(0.5)
    return (
        scoup.load_gaussians(folder / "scene" / "model.splat"),
        cameras,
        scoup.load_regions(features, cameras),
    )


def codes_of(field: scoup.LanguageField) -> dict[str, np.ndarray]:
    """All codes, for a small scene."""
    return {"indices": field.code_indices.numpy(), "weights": field.code_weights.float().numpy()}


def projections_of(field: scoup.LanguageField) -> dict[str, np.ndarray]:
    """[S, L] sums of the dense codes with random signs: tells changes of a large scene without keeping its codes."""
    count, levels, _ = field.code_indices.shape
    signs = torch.randint(0, 2, (count,), generator=torch.Generator().manual_seed(0)).double() * 2 - 1
    sums = torch.zeros(levels, field.n_atoms, dtype=torch.float64)
    for level in range(levels):
        weights = field.code_weights[:, level].double() * signs[:, None]
        sums[level].scatter_add_(0, field.code_indices[:, level].long().flatten(), weights.flatten())
    return {"projections": sums.numpy(), "coded": np.array(int(field.coded().sum()))}


def main(folder: Path) -> None:
    frozen = {}
    for name in BUILDS:
        for part, values in codes_of(build(name, *room())).items():
            frozen[f"{name}/{part}"] = values
    np.savez_compressed(folder / "room.npz", **frozen)
    data = Path(os.environ.get("SCOUP_TEST_DATA", "../shared/data")) / "kitchen"
    if not data.is_dir():
        return
    with tempfile.TemporaryDirectory() as features:
        scene = kitchen(data, Path(features))
        frozen = {}
        for name in BUILDS:
            for part, values in projections_of(build(name, *scene)).items():
                frozen[f"{name}/{part}"] = values
    np.savez_compressed(folder / "kitchen.npz", **frozen)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
