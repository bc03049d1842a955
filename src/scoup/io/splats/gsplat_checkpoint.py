"""Checkpoints of gsplat's trainer: ckpts/ckpt_<step>_rank<r>.pt, one file a rank."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path

import numpy as np

from scoup.base.errors import FileFormatError, MissingFileError
from scoup.base.existing import existing_file
from scoup.io.cameras.training_run import is_gsplat_results
from scoup.io.splats.activation import keep_finite, opacities_from_logits, scales_from_logs, unit_quats
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.torch_file import float_tensor, load_torch
from scoup.scene.gaussians import MAX_SH_DEGREE, Gaussians

_NAME = re.compile(r"ckpt_(\d{1,12})_rank(\d{1,6})\.pt")
_EXPORT = re.compile(r"point_cloud_(\d{1,12})\.ply")
_SHAPES = {"means": (3,), "quats": (4,), "scales": (3,), "opacities": (), "sh0": (1, 3), "shN": (-1, 3)}
_WHAT = "a checkpoint of gsplat's trainer"
_WITHOUT_OBJECTS = (
    "use the ckpt_*_rank*.pt that gsplat's trainer wrote, or a PLY; if you trust the file, save its tensors alone "
    "where it was made: torch.save({'splats': {name: tensor}}, path)"
)


def read_gsplat_checkpoint(path: str | Path) -> Gaussians:
    """Read one checkpoint file, or all ranks of the latest step in a ``ckpts`` folder (or above it).

    Pickles are read with torch's restricted loader: nothing in them is run.

    Warns:
        ScoupWarning: rows with values that are not finite were dropped.
    """
    path = Path(path)
    files = latest_ranks(path) if path.is_dir() else [existing_file(path, _WHAT)]
    parts = [_read_splats(file) for file in files]
    if len({part["shN"].shape[1] for part in parts}) > 1:
        raise FileFormatError(
            path, "its ranks differ in SH degree", "they are from different runs; remove the old ones"
        )
    raw = {key: np.concatenate([part[key] for part in parts]) for key in _SHAPES}
    return keep_finite(
        means=raw["means"],
        quats=unit_quats(raw["quats"]),
        scales=scales_from_logs(raw["scales"]),
        opacities=opacities_from_logits(raw["opacities"]),
        sh=np.concatenate([raw["sh0"], raw["shN"]], axis=1),
        source=str(path),
    )[0]


def exported_splat(results: str | Path) -> Path:
    """Return the splat of the last step that gsplat's trainer exported: ply/point_cloud_<step>.ply."""
    steps = {
        int(matched[1]): file
        for file in (Path(results) / "ply").glob("point_cloud_*.ply")
        if (matched := _EXPORT.fullmatch(file.name))
    }
    if not steps:
        problem = "contains no ckpts/ckpt_<step>_rank<r>.pt and no ply/point_cloud_<step>.ply"
        raise MissingFileError(results, problem, "use a folder of gsplat's trainer with its splat")
    return steps[max(steps)]


def latest_ranks(folder: str | Path) -> list[Path]:
    """Return the files of the latest step in a ckpts folder (or in the one inside ``folder``), in order of rank."""
    folder = Path(folder)
    if (folder / "ckpts").is_dir():
        folder = folder / "ckpts"
    steps: dict[int, dict[int, Path]] = defaultdict(dict)
    for file in folder.glob("ckpt_*_rank*.pt"):
        matched = _NAME.fullmatch(file.name)
        if matched:
            steps[int(matched[1])][int(matched[2])] = file
    if not steps:
        raise MissingFileError(
            folder, "contains no ckpt_<step>_rank<r>.pt", "use the folder ckpts of gsplat's trainer"
        )
    step, ranks = max(steps.items())
    # The number of ranks is not written anywhere: the most that any step has is the best guess.
    expected = 1 + max(rank for files in steps.values() for rank in files)
    missing = sorted(set(range(expected)) - set(ranks))
    if missing:
        listed = ", ".join(map(str, missing[:8]))
        raise MissingFileError(
            folder,
            f"step {step} lacks rank {listed} of {expected}",
            "copy all its files, or remove this step",
        )
    return [ranks[rank] for rank in range(expected)]


def _read_splats(path: Path) -> dict[str, np.ndarray]:
    content = load_torch(path, _WHAT, _WITHOUT_OBJECTS, numpy_numbers=True)
    if isinstance(content, (tuple, list)):
        remedy = "use point_cloud/iteration_*/point_cloud.ply of its training; for language features, scoup convert"
        raise FileFormatError(
            path, "is a checkpoint of Inria's code or a relative, such as LangSplat", remedy
        )
    splats = content.get("splats") if isinstance(content, dict) else None
    if not isinstance(splats, dict):
        raise FileFormatError(path, "has no entry 'splats'", f"it should be {_WHAT}")
    missing = [key for key in _SHAPES if key not in splats]
    if missing:
        remedy = (
            "trained with appearance features, it has no SH colours; export a PLY"
            if "colors" in splats
            else ""
        )
        raise FileFormatError(path, f"lacks {', '.join(missing)}", remedy or f"it should be {_WHAT}")
    means = float_tensor(path, splats["means"], (-1, 3), "means", _WHAT)
    result = {
        key: float_tensor(path, splats[key], (len(means), *shape), key, _WHAT)
        for key, shape in _SHAPES.items()
    }
    if result["shN"].shape[1] + 1 not in {(degree + 1) ** 2 for degree in range(MAX_SH_DEGREE + 1)}:
        raise FileFormatError(
            path,
            f"shN has {result['shN'].shape[1]} coefficients, no whole SH degree",
            f"it should be {_WHAT}",
        )
    return result


def _in_results(folder: Path) -> Path | None:
    """Return the splat in a folder of gsplat's trainer: the folder itself, for its checkpoints, or the last export."""
    if is_gsplat_results(folder) and not any((folder / "ckpts").glob("*.pt")):
        return exported_splat(folder)
    has_checkpoints = (folder / "ckpts").is_dir() or any(folder.glob("ckpt_*_rank*.pt"))
    return folder if has_checkpoints else None


FORMAT = SplatFormat(
    "gsplat checkpoint",
    (".pt", ".pth", ".ckpt"),
    read_gsplat_checkpoint,
    preset="gsplat",
    find=_in_results,
    in_scenes=False,
)
