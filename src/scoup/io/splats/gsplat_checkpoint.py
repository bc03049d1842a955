"""Checkpoints of gsplat's trainer: ckpts/ckpt_<step>_rank<r>.pt, one file a rank."""

from __future__ import annotations

from itertools import islice
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, MissingFileError
from scoup.io.cameras.training_run import is_gsplat_results
from scoup.io.reading import numbered_files
from scoup.io.splats.activation import trained_gaussians
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.torch_file import float_tensors, load_torch
from scoup.scene import Gaussians

_RANKS = "ckpt_*_rank*.pt"
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
    files = latest_ranks(path) if path.is_dir() else [path]
    ranks = [_read_splats(file) for file in files]
    if len({rank["shN"].shape[1] for rank in ranks}) > 1:
        raise FileFormatError(
            path, "its ranks differ in SH degree", "they are from different runs; remove the old ones"
        )
    raw = {key: np.concatenate([rank[key] for rank in ranks]) for key in _SHAPES}
    sh = np.concatenate([raw["sh0"], raw["shN"]], axis=1)
    columns = (raw["means"], raw["quats"], raw["scales"], raw["opacities"])
    return trained_gaussians(path, *columns, sh, _WHAT)[0]


def latest_ranks(folder: str | Path) -> list[Path]:
    """Return the files of the latest step in a ckpts folder (or in the one inside ``folder``), in order of rank."""
    folder = Path(folder)
    if (folder / "ckpts").is_dir():
        folder = folder / "ckpts"
    files = numbered_files(folder, _RANKS)
    if not files:
        remedy = "use the folder ckpts of gsplat's trainer"
        raise MissingFileError(folder, "contains no ckpt_<step>_rank<r>.pt", remedy)
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
        remedy = "it was trained with appearance features; export a PLY"
        raise FileFormatError(path, "has no SH colours", remedy)
    return float_tensors(path, splats, _SHAPES, _WHAT)


def _in_results(folder: Path) -> Path | None:
    """Return the splat in a folder of gsplat's trainer: the folder itself, for its checkpoints, or the last export."""
    if is_gsplat_results(folder) and not any((folder / "ckpts").glob("*.pt")):
        steps = numbered_files(folder, "ply/point_cloud_*.ply")
        if not steps:
            problem = "contains no ckpts/ckpt_<step>_rank<r>.pt and no ply/point_cloud_<step>.ply"
            raise MissingFileError(folder, problem, "use a folder of gsplat's trainer with its splat")
        return steps[max(steps)]
    has_checkpoints = (folder / "ckpts").is_dir() or any(folder.glob(_RANKS))
    return folder if has_checkpoints else None


FORMAT = SplatFormat(
    "gsplat checkpoint",
    (".pt", ".pth", ".ckpt"),
    read_gsplat_checkpoint,
    preset="gsplat",
    find=_in_results,
    in_scenes=False,
)
