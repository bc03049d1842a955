"""Checkpoints of nerfstudio's splatfacto: nerfstudio_models/step-<step>.ckpt."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np

from scoup.base.errors import FileFormatError, MissingFileError
from scoup.io.cameras.training_run import is_nerfstudio_run
from scoup.io.splats.activation import keep_finite, opacities_from_logits, scales_from_logs, unit_quats
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.torch_file import float_tensor, load_torch
from scoup.scene.gaussians import MAX_SH_DEGREE, SH_C0, Gaussians

MODELS = "nerfstudio_models"
_NAME = re.compile(r"step-(\d{1,12})\.ckpt")
_WHAT = "a checkpoint of nerfstudio's splatfacto"
_EXPORT = "export the splat and use that: ns-export gaussian-splat"
_PREFIXES = ("_model.gauss_params.", "_model.")  # newer, older
_SHAPES = {
    "means": (-1, 3),
    "quats": (-1, 4),
    "scales": (-1, 3),
    "opacities": (-1, 1),
    "features_dc": (-1, 3),
    "features_rest": (-1, -1, 3),
}


def is_splatfacto_name(path: str | Path) -> bool:
    """Return whether a file is named as nerfstudio names its checkpoints."""
    return _NAME.fullmatch(Path(path).name) is not None


def latest_checkpoint(run: str | Path) -> Path | None:
    """Return the checkpoint of the last step in a run's folder, if there is one."""
    steps = {}
    for file in (Path(run) / MODELS).glob("step-*.ckpt"):
        matched = _NAME.fullmatch(file.name)
        if matched:
            steps[int(matched[1])] = file
    return steps[max(steps)] if steps else None


def splat_of_run(run: str | Path) -> Path:
    """Return the last checkpoint of a run, otherwise the splat exported into it or into its ``exports``."""
    run = Path(run)
    checkpoint = latest_checkpoint(run)
    if checkpoint is not None:
        return checkpoint
    exports = sorted([*run.glob("*.ply"), *run.glob("exports/*.ply"), *run.glob("exports/*/*.ply")])
    if len(exports) != 1:
        problem = f"contains no {MODELS}/step-*.ckpt and {len(exports)} exported splats"
        raise MissingFileError(run, problem, f"name the .ply itself, or {_EXPORT}")
    return exports[0]


def read_splatfacto(path: str | Path) -> Gaussians:
    """Read one checkpoint of splatfacto. It is read with torch's restricted loader: nothing in it is run."""
    path = Path(path)
    raw = _tensors(path, load_torch(path, _WHAT, _EXPORT))
    count = {len(array) for array in raw.values()}
    bases = raw["features_rest"].shape[1] + 1
    if len(count) > 1 or bases not in {(degree + 1) ** 2 for degree in range(MAX_SH_DEGREE + 1)}:
        problem = f"its tensors do not belong together ({sorted(count)} rows, {bases} coefficients)"
        raise FileFormatError(path, problem, f"it should be {_WHAT}")
    constant = raw["features_dc"]
    if bases == 1:
        # Trained without spherical harmonics, splatfacto keeps logits of RGB.
        constant = ((opacities_from_logits(constant) - 0.5) / SH_C0).astype(np.float32)
    return keep_finite(
        means=raw["means"],
        quats=unit_quats(raw["quats"]),
        scales=scales_from_logs(raw["scales"]),
        opacities=opacities_from_logits(raw["opacities"])[:, 0],
        sh=np.concatenate([constant[:, None], raw["features_rest"]], axis=1),
        source=str(path),
    )[0]


def _tensors(path: Path, content: Any) -> dict[str, np.ndarray]:
    pipeline = content.get("pipeline") if isinstance(content, dict) else None
    if not isinstance(pipeline, dict):
        raise FileFormatError(path, "has no entry 'pipeline'", f"it should be {_WHAT}")
    plain = {str(key).removeprefix("module."): value for key, value in pipeline.items()}
    prefix = next((prefix for prefix in _PREFIXES if f"{prefix}means" in plain), None)
    if prefix is None:
        raise FileFormatError(path, "contains no Gaussians (another method of nerfstudio)", f"use {_WHAT}")
    return {
        name: float_tensor(path, plain.get(prefix + name), shape, prefix + name, _WHAT)
        for name, shape in _SHAPES.items()
    }


FORMAT = SplatFormat(
    "nerfstudio checkpoint",
    (".ckpt",),
    read_splatfacto,
    preset="gsplat",
    has_name=is_splatfacto_name,
    find=lambda folder: splat_of_run(folder) if is_nerfstudio_run(folder) else None,
    in_scenes=False,
)
