"""Checkpoints of gsplat's trainers: ckpts/ckpt_<step>_rank<r>.pt, one file a rank; of 2DGS ckpt_<step>.pt."""

from __future__ import annotations

import re
import warnings
from itertools import islice
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, MissingFileError, ScoupWarning
from scoup.io.cameras.training_run import is_gsplat_results, trained_as
from scoup.io.reading import numbered_files
from scoup.io.splats.activation import WITHOUT_SH, trained_gaussians
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.torch_file import float_tensors, load_torch
from scoup.scene import Gaussians

_RANKS, _WHOLE = "ckpt_*_rank*.pt", "ckpt_*.pt"
_MOSTLY = 2 / 3  # of the Gaussians
_SHAPES = {"means": (3,), "quats": (4,), "scales": (-1,), "opacities": (), "sh0": (1, 3), "shN": (-1, 3)}
_WHAT = "a checkpoint of gsplat's trainer"
_WITHOUT_OBJECTS = (
    "use the ckpt_*_rank*.pt that gsplat's trainer wrote, or a PLY; if you trust the file, save its tensors alone "
    "where it was made: torch.save({'splats': {name: tensor}}, path)"
)


def read_gsplat_checkpoint(path: str | Path, activated: bool = False) -> Gaussians:
    """Read one checkpoint file, or all ranks of the latest step in a ``ckpts`` folder (or above it)."""
    path = Path(path)
    files = latest_ranks(path) if path.is_dir() else [path]
    ranks = [_read_splats(file) for file in files]
    if len({rank["shN"].shape[1] for rank in ranks}) > 1:
        raise FileFormatError(
            path, "its ranks differ in SH degree", "they are from different runs; remove the old ones"
        )
    raw = {key: np.concatenate([rank[key] for rank in ranks]) for key in _SHAPES}
    sh = np.concatenate([raw["sh0"], raw["shN"]], axis=1)
    if _is_flat(files[0], raw["scales"]):
        raw["scales"] = raw["scales"][:, :2]
    columns = (raw["means"], raw["quats"], raw["scales"], raw["opacities"])
    return trained_gaussians(path, *columns, sh, _WHAT, activated)[0]


def _is_flat(path: Path, logs: np.ndarray) -> bool:
    """Return whether the third of three scales was never trained: of 2DGS, which leaves it at its first value."""
    if logs.shape[1] != 3 or not len(logs):
        return False
    said = trained_as(path)
    if said:
        return said.startswith("2dgs")
    left = len(np.unique(logs[:, 2])) <= len(logs) // 10
    if re.fullmatch(r"ckpt_\d+\.pt", path.name):  # no trainer of today's 3DGS writes this
        left |= float((logs.argmax(1) == 2).mean()) > _MOSTLY
    if left:
        message = (
            f"{path}: taken for 2DGS, as its third scale looks untrained: the Gaussians are read as flat"
        )
        warnings.warn(message, ScoupWarning, stacklevel=4)
    return left


def latest_ranks(folder: str | Path) -> list[Path]:
    """Return the files of the latest step in a ckpts folder (or in the one inside ``folder``), in order of rank."""
    folder = Path(folder)
    if (folder / "ckpts").is_dir():
        folder = folder / "ckpts"
    whole = {(step, 0): file for (step,), file in numbered_files(folder, _WHOLE).items()}
    files = {**whole, **numbered_files(folder, _RANKS)}
    if not files:
        remedy = "use the folder ckpts of gsplat's trainer"
        raise MissingFileError(folder, "contains no ckpt_<step>.pt or ckpt_<step>_rank<r>.pt", remedy)
    last, _ = max(files)
    # The number of ranks is not written anywhere: the most that any step has is the best guess.
    expected = 1 + max(rank for _, rank in files)
    if missing := list(islice((rank for rank in range(expected) if (last, rank) not in files), 8)):
        problem = f"step {last} lacks rank {', '.join(map(str, missing))} of {expected}"
        raise MissingFileError(folder, problem, "copy all its files, or remove this step")
    return [files[last, rank] for rank in range(expected)]


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
    if "colors" in splats and "sh0" not in splats:
        raise FileFormatError(path, *WITHOUT_SH)
    return float_tensors(path, splats, _SHAPES, _WHAT)


def _in_results(folder: Path) -> Path | None:
    """Return the splat in a folder of gsplat's trainer: the folder itself, for its checkpoints, or the last export."""
    if is_gsplat_results(folder) and not any((folder / "ckpts").glob("*.pt")):
        steps = numbered_files(folder, "ply/point_cloud_*.ply")
        if not steps:
            problem = "contains no ckpts/ckpt_<step>.pt and no ply/point_cloud_<step>.ply"
            raise MissingFileError(folder, problem, "use a folder of gsplat's trainer with its splat")
        return steps[max(steps)]
    has_checkpoints = (folder / "ckpts").is_dir() or any(folder.glob(_WHOLE))
    return folder if has_checkpoints else None


FORMAT = SplatFormat(
    "gsplat checkpoint",
    (".pt", ".pth", ".ckpt"),
    read_gsplat_checkpoint,
    preset="gsplat",
    find=_in_results,
    in_scenes=False,
    keeps_logs=True,
)
