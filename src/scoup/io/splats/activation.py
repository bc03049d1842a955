"""Between the raw values files hold (log scale, logit opacity) and those the API gives.

All functions compute in float64 and round once, so that values read from a float32 file are written back to
values that read the same, bit by bit.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import torch

from scoup.base import FileFormatError, InputError, ScoupWarning, counted
from scoup.scene import MAX_SH_DEGREE, Gaussians

SH_BASES = tuple((degree + 1) ** 2 for degree in range(MAX_SH_DEGREE + 1))
WITHOUT_SH = (
    "has no SH colours",
    "it was trained with appearance features (such as splatfacto-w); export a PLY with its own script",
)
# Third scale of flat Gaussians, by the smaller of two; viewers take 1e-6 in any unit.
_LOG_THIN = math.log(3e-4)
_LEAST_JUDGED = 16  # Gaussians
_HUGE = 0.05  # of the extent, for the median Gaussian
UNIT_TOLERANCE = 1e-6  # of the squared norm: what float32 rounding of a unit quaternion stays well within


def scales_from_logs(raw: np.ndarray) -> np.ndarray:
    """Return the exponential, float32; overflow gives inf."""
    with np.errstate(all="ignore"):
        return np.exp(raw.astype(np.float64)).astype(np.float32)


def opacities_from_logits(raw: np.ndarray) -> np.ndarray:
    """Return the logistic function, float32; +inf gives exactly 1, -inf exactly 0."""
    with np.errstate(all="ignore"):
        return (1.0 / (1.0 + np.exp(-raw.astype(np.float64)))).astype(np.float32)


def logs_from_scales(scales: np.ndarray) -> np.ndarray:
    """Return float32 logarithms that ``scales_from_logs`` maps back as closely as float32 can."""
    with np.errstate(all="ignore"):
        raw = np.log(scales.astype(np.float64)).astype(np.float32)
    return _settled(raw, scales, scales_from_logs)


def logits_from_opacities(opacities: np.ndarray) -> np.ndarray:
    """Return float32 logits that ``opacities_from_logits`` maps back as closely as float32 can."""
    clipped = np.clip(opacities, 0.0, 1.0)
    wide = clipped.astype(np.float64)
    with np.errstate(all="ignore"):
        raw = (np.log(wide) - np.log1p(-wide)).astype(np.float32)
    return _settled(raw, clipped, opacities_from_logits)


def unit_quats(raw: np.ndarray) -> np.ndarray:
    """Normalise quaternions to [N, 4] float32. Unit rows stay as they are; zero rows become NaN."""
    with np.errstate(all="ignore"):
        wide = raw.astype(np.float64)
        squared = (wide**2).sum(1, keepdims=True)
        normalised = (wide / np.sqrt(squared)).astype(np.float32)
    return np.where(np.abs(squared - 1.0) < UNIT_TOLERANCE, raw.astype(np.float32), normalised)


def logs_and_logits(
    path: Path, means: np.ndarray, scales: np.ndarray, opacities: np.ndarray, activated: bool | None
) -> tuple[np.ndarray, np.ndarray]:
    """Return logarithms of stored scales [N, 1 to 3] and logits of stored opacities [N]; ``activated`` as of
    ``PlyTable.gaussians``."""
    if activated is False and any(found := _find_activated(means, scales, opacities)):
        names = " and ".join(name for name, one in zip(("scales", "opacities"), found, strict=True) if one)
        raise FileFormatError(
            path,
            f"seems to store {names} as they are, not as logarithms and logits (scales {np.nanmin(scales):.3g} to "
            f"{np.nanmax(scales):.3g}, opacities {np.nanmin(opacities):.3g} to {np.nanmax(opacities):.3g})",
            f"if so, rewrite it: scoup convert {path} OUT.ply `activated=True`",
        )
    with np.errstate(all="ignore"):
        if activated and np.nanmin(scales, initial=0) >= 0:
            scales = np.log(scales.astype(np.float64))
        if activated and np.nanmin(opacities, initial=0) >= 0 and np.nanmax(opacities, initial=1) <= 1:
            opacities = opacities.astype(np.float64)
            opacities = np.log(opacities) - np.log1p(-opacities)
    return scales, opacities


def _find_activated(means: np.ndarray, scales: np.ndarray, opacities: np.ndarray) -> tuple[bool, bool]:
    """Return whether stored scales [N, S], and opacities [N], have values that logarithms and logits of a trained splat
    do not have, but lengths and opacities do."""
    finite = np.isfinite(scales).all(1) & np.isfinite(opacities) & np.isfinite(means).all(1)
    if int(finite.sum()) < _LEAST_JUDGED:
        return False, False
    means, scales, opacities = means[finite], scales[finite], opacities[finite]
    lowest, highest = float(opacities.min()), float(opacities.max())
    of_opacity = 0 <= lowest < 0.1 and 0.9 < highest <= 1
    extent = float(np.linalg.norm(np.subtract(*np.quantile(means, (0.95, 0.05), axis=0))))
    with np.errstate(all="ignore"):
        huge = float(np.exp(np.median(scales))) > _HUGE * extent
    return bool(scales.min() >= 0 and (of_opacity or huge)), of_opacity


def three_logs(logs: np.ndarray) -> np.ndarray:
    """Return [N, 3] scales of [N, 1 to 3]: one is that of all axes, two are those of a flat Gaussian."""
    if logs.shape[1] == 1:
        return np.repeat(logs, 3, axis=1)
    return logs if logs.shape[1] == 3 else np.c_[logs, logs.min(1) + _LOG_THIN]


def trained_gaussians(
    path: Path,
    means: np.ndarray,
    quats: np.ndarray,
    logs: np.ndarray,
    logits: np.ndarray,
    sh: np.ndarray,
    what: str,
    activated: bool | None = None,
) -> tuple[Gaussians, np.ndarray]:
    """Return ``keep_finite`` of what trainers keep: quaternions of any norm, ``logs_and_logits``.
    ``what`` the file should be is for the FileFormatError of harmonics [N, B, 3] of no degree."""
    if logs.shape[1] not in (1, 2, 3):
        raise FileFormatError(path, f"has {logs.shape[1]} scales per Gaussian", f"it should be {what}")
    if sh.shape[1] not in SH_BASES:
        problem = f"has {sh.shape[1] - 1} coefficients above SH degree 0, no whole SH degree"
        raise FileFormatError(path, problem, f"it should be {what}")
    logs, logits = logs_and_logits(path, means, logs, logits, activated)
    return keep_finite(
        means,
        unit_quats(quats),
        scales_from_logs(three_logs(logs)),
        opacities_from_logits(logits),
        sh,
        str(path),
    )


def keep_finite(
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    sh: np.ndarray,
    source: str,
) -> tuple[Gaussians, np.ndarray]:
    """Return Gaussians of the rows whose activated values are all finite, and a boolean [N] saying which they are."""
    arrays = [means, quats, scales, opacities, sh]
    finite = finite_rows(arrays)
    if not finite.all():
        warn_of_dropped(len(finite) - int(finite.sum()), len(finite), source, stacklevel=5)
        arrays = [array[finite] for array in arrays]
    tensors = [torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)) for array in arrays]
    return Gaussians(*tensors, source_rows=None if finite.all() else torch.from_numpy(finite)), finite


def finite_rows(arrays: Sequence[np.ndarray]) -> np.ndarray:
    """Return boolean [N]: rows that are finite in all arrays [N, ...]."""
    rows = np.ones(len(arrays[0]), bool)
    for array in arrays:
        finite = np.isfinite(array)
        if not finite.all():  # row by row takes ten times as long
            rows &= finite.all(tuple(range(1, array.ndim)))
    return rows


def warn_of_dropped(dropped: int, total: int, source: str, stacklevel: int = 2) -> None:
    warnings.warn(
        f"{source}: dropped {dropped:,} of {counted(total, 'Gaussian')} with values that are not finite, or "
        "without a rotation (a quaternion of zeros)",
        ScoupWarning,
        stacklevel,
    )


def finite_arrays(gaussians: Gaussians, path: str | Path) -> dict[str, np.ndarray]:
    """Return means, quats (unit norm; of zeros: no turn), scales (positive), opacities (0 to 1) and sh, for a writer
    that has no place for other values: float64 that float32 holds."""
    if not bool((gaussians.finite() & torch.isfinite(gaussians.sh).flatten(1).all(1)).all()):
        raise InputError(f"{path}: some Gaussians have values that are not finite; remove these first")
    arrays = {
        name: tensor.detach().cpu().numpy().astype(np.float64) for name, tensor in gaussians.tensors().items()
    }
    quats = unit_quats(arrays["quats"]).astype(np.float64)
    quats[np.isnan(quats).any(1)] = (1.0, 0.0, 0.0, 0.0)
    scales, opacities = np.abs(arrays["scales"]), arrays["opacities"].clip(0.0, 1.0)
    return {**arrays, "quats": quats, "scales": scales, "opacities": opacities}


def _settled(raw: np.ndarray, wanted: np.ndarray, forward: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return ``raw``, or a float32 neighbour where that maps to ``wanted`` and ``raw`` does not."""
    wrong = np.flatnonzero((forward(raw) != wanted).ravel() & np.isfinite(raw.ravel()))
    if not len(wrong):
        return raw
    settled, target = raw.ravel().copy(), wanted.ravel()[wrong]
    start = settled[wrong]
    for direction in (np.float32(-np.inf), np.float32(np.inf)):
        neighbour = np.nextafter(start, direction)
        settled[wrong] = np.where(forward(neighbour) == target, neighbour, settled[wrong])
    return settled.reshape(raw.shape)
