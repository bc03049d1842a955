"""Checkpoints of nerfstudio's splatfacto: nerfstudio_models/step-<step>.ckpt."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from scoup.base import FileFormatError, MissingFileError
from scoup.io.cameras.training_run import is_nerfstudio_run
from scoup.io.reading import numbered_files
from scoup.io.splats.activation import WITHOUT_SH, opacities_from_logits, trained_gaussians
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.torch_file import float_tensors, load_torch
from scoup.scene import SH_C0, Gaussians

MODELS = "nerfstudio_models"
_WHAT = "a checkpoint of nerfstudio's splatfacto"
_EXPORT = "export the splat and use that: ns-export gaussian-splat"
_PREFIXES = ("_model.gauss_params.", "_model.")  # newer, older
_SHAPES = {  # of a Gaussian
    "means": (3,), "quats": (4,), "scales": (-1,), "opacities": (1,), "features_dc": (3,), "features_rest": (-1, 3),
}  # fmt: skip


def read_splatfacto(path: str | Path, activated: bool = False) -> Gaussians:
    path = Path(path)
    raw = _tensors(path, load_torch(path, _WHAT, _EXPORT))
    constant, rest = raw["features_dc"], raw["features_rest"]
    if not rest.shape[1]:
        # Trained without spherical harmonics, splatfacto keeps logits of RGB.
        constant = ((opacities_from_logits(constant) - 0.5) / SH_C0).astype(np.float32)
    sh = np.concatenate([constant[:, None], rest], axis=1)
    columns = (raw["means"], raw["quats"], raw["scales"], raw["opacities"][:, 0])
    return trained_gaussians(path, *columns, sh, _WHAT, activated)[0]


def _tensors(path: Path, content: Any) -> dict[str, np.ndarray]:
    pipeline = content.get("pipeline") if isinstance(content, dict) else None
    if not isinstance(pipeline, dict):
        raise FileFormatError(path, "has no entry 'pipeline'", f"it should be {_WHAT}")
    plain = {str(key).removeprefix("module."): value for key, value in pipeline.items()}
    for prefix in _PREFIXES:
        if f"{prefix}means" in plain:
            if plain.get(f"{prefix}features_dc") is None and f"{prefix}colors" in plain:
                raise FileFormatError(path, *WITHOUT_SH)
            shapes = {prefix + name: shape for name, shape in _SHAPES.items()}
            tensors = float_tensors(path, plain, shapes, _WHAT)
            return {name.removeprefix(prefix): tensor for name, tensor in tensors.items()}
    raise FileFormatError(path, "contains no Gaussians (another method of nerfstudio)", f"use {_WHAT}")


def _in_run(run: Path) -> Path | None:
    """Return the last checkpoint of a run, otherwise the splat exported into it or into its ``exports``."""
    if not is_nerfstudio_run(run):
        return None
    if steps := numbered_files(run, f"{MODELS}/step-*.ckpt"):
        return steps[max(steps)]
    exports = sorted([*run.glob("*.ply"), *run.glob("exports/*.ply"), *run.glob("exports/*/*.ply")])
    if len(exports) != 1:
        problem = f"contains no {MODELS}/step-*.ckpt and {len(exports)} exported splats"
        raise MissingFileError(run, problem, f"name the .ply itself, or {_EXPORT}")
    return exports[0]


FORMAT = SplatFormat(
    "nerfstudio checkpoint",
    (".ckpt",),
    read_splatfacto,
    preset="gsplat",
    has_name=lambda path: re.fullmatch(r"step-\d{1,12}\.ckpt", path.name) is not None,
    find=_in_run,
    in_scenes=False,
    keeps_logs=True,
)
