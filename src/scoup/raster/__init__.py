"""The rasteriser's contract: look once, ask often, all levels in one pass.

``look`` projects, bins and sorts a scene for one camera. The other functions take its view and answer; they all
use the same blending weights e = alpha * transmittance of each Gaussian at each pixel (method.md, stage 2), so
what is lifted is exactly what is rendered. Gaussians that are not finite are never drawn; a pixel nothing paints
is zero.

A backend is one module with these functions. It is chosen by the device of the tensors, or by name; so far there
is ``reference`` (plain torch, any device).
"""

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TypeAlias

import torch
from torch import Tensor

from scoup.cameras import Camera
from scoup.codes import SparseCodes
from scoup.errors import InputError, UnknownNameError
from scoup.gaussians import Gaussians
from scoup.raster.presets import PRESETS as PRESETS
from scoup.raster.presets import RasterPreset as RasterPreset
from scoup.raster.presets import raster_preset
from scoup.raster.reference import ReferenceView
from scoup.raster.spherical_harmonics import view_colors as view_colors

View: TypeAlias = ReferenceView

BACKENDS = {"reference": "scoup.raster.reference"}


def default_backend(device: torch.device) -> str:
    """The fastest backend that serves tensors on this device."""
    return "reference"


def look(
    gaussians: Gaussians, camera: Camera, preset: str | RasterPreset = "inria", backend: str | None = None
) -> View:
    """Prepare a scene for one camera: project, bin and sort.

    Args:
        gaussians: N Gaussians.
        camera: the pinhole view.
        preset: rasteriser constants: "inria" (default) or "gsplat".
        backend: name of a backend; by default the fastest for the tensors' device.

    Returns:
        A view for the functions below. It keeps no reference to colours or codes.

    Raises:
        UnknownNameError: no preset or backend has that name.
    """
    name = backend or default_backend(gaussians.device)
    return _module(name).look(gaussians, camera, raster_preset(preset))


def region_weights(view: View, labels: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """How much each Gaussian paints of each region: A[i, r] = sum of e_i over the pixels of r (method.md, stage 2).

    Args:
        view: from ``look``.
        labels: [S, H, W] integer region of each pixel at each level, -1 for none.

    Returns:
        Triplets (gaussian [T] int64, key [T] int64, weight [T] float32), sorted by Gaussian, then key, each pair
        once; key = level * stride + region with stride = labels.max() + 1. Pairs of weight zero are left out.

    Raises:
        InputError: the labels do not have the view's size.
    """
    _check_labels(view, labels)
    return _module(view.backend).region_weights(view, labels)


def uplift_view(view: View, labels: Tensor, codes: list[SparseCodes], out: Tensor) -> None:
    """Add this view's weighted region codes to the accumulators: w_i += sum of e_i(p) * W(p) (method.md, stage 2).

    Args:
        view: from ``look``.
        labels: [S, H, W] integer regions, -1 for none.
        codes: one SparseCodes a level, row r for region r.
        out: [N, S, L] float32, added to in place.

    Raises:
        InputError: shapes disagree, or a label has no code.
    """
    _check_labels(view, labels)
    if len(codes) != len(labels) or out.dim() != 3 or tuple(out.shape[:2]) != (view.n_gaussians, len(labels)):
        raise InputError(
            f"accumulators {list(out.shape)} and {len(codes)} levels of codes do not fit {view.n_gaussians} "
            f"Gaussians and {len(labels)} levels of labels"
        )
    if not out.is_contiguous() or out.dtype != torch.float32:
        raise InputError("accumulators must be contiguous float32")
    for level, level_codes in enumerate(codes):
        highest = int(labels[level].max()) if labels[level].numel() else -1
        if highest >= len(level_codes):
            raise InputError(f"level {level}: label {highest} has no code, there are {len(level_codes)}")
        if level_codes.n_atoms != out.shape[2]:
            raise InputError(
                f"level {level}: codes over {level_codes.n_atoms} atoms, accumulators {out.shape[2]}"
            )
    _module(view.backend).uplift_view(view, labels, codes, out)


def render_channels(view: View, values: Tensor) -> tuple[Tensor, Tensor]:
    """Render any per-Gaussian values.

    Args:
        view: from ``look``.
        values: [N, C] float32.

    Returns:
        image [H, W, C] = sum of e_i * values_i, and alpha [H, W] = sum of e_i (one minus the transmittance left).
    """
    _check_rows(view, values, 2, "values")
    return _module(view.backend).render_channels(view, values)


def render_codes(view: View, indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
    """Render sparse codes of all levels: the coefficient maps W^(p) of method.md, stage 3.

    Args:
        view: from ``look``.
        indices: [N, S, K] integer atoms.
        weights: [N, S, K] float weights (float16 or float32).
        n_atoms: L.

    Returns:
        [S, H, W, L] float32.
    """
    _check_codes(view, indices, weights)
    return _module(view.backend).render_codes(view, indices, weights, n_atoms)


def render_cosines(view: View, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor) -> Tensor:
    """Cosine between the rendered feature of each pixel and each query, without any map of D or L channels.

    Uses cos = (W A) / sqrt(W G W^T) with A = C T^T and G = C C^T (method.md, stage 3). Pixels that no code
    reaches get 0.

    Args:
        view: from ``look``.
        indices, weights: [N, S, K] sparse codes.
        codebook: [S, L, D] float32.
        queries: [Q, D] float32, unit norm.

    Returns:
        [S, Q, H, W] float32.
    """
    _check_codes(view, indices, weights)
    if (
        codebook.dim() != 3
        or codebook.shape[0] != indices.shape[1]
        or queries.shape[1:] != codebook.shape[2:]
    ):
        raise InputError(
            f"codebook {list(codebook.shape)} and queries {list(queries.shape)} do not fit {indices.shape[1]} levels"
        )
    return _module(view.backend).render_cosines(view, indices, weights, codebook, queries)


def render_colors(
    gaussians: Gaussians, camera: Camera, view: View | None = None, background: float = 0.0
) -> Tensor:
    """[H, W, 3] float32 colour render in 0..1 over a grey background; ``view`` saves looking again."""
    view = view if view is not None else look(gaussians, camera)
    image, alpha = render_channels(view, view_colors(gaussians, camera))
    return (image + (1.0 - alpha)[..., None] * background).clamp(0, 1)


def _module(name: str) -> ModuleType:
    if name not in BACKENDS:
        raise UnknownNameError("raster backend", name, BACKENDS)
    return importlib.import_module(BACKENDS[name])


def _check_labels(view: View, labels: Tensor) -> None:
    if labels.dim() != 3 or tuple(labels.shape[1:]) != (view.height, view.width):
        raise InputError(
            f"labels {list(labels.shape)} do not fit a view of {view.height} x {view.width} (H x W)"
        )
    if labels.is_floating_point():
        raise InputError(f"labels must be integers, got {labels.dtype}")


def _check_rows(view: View, values: Tensor, dims: int, name: str) -> None:
    if values.dim() != dims or values.shape[0] != view.n_gaussians:
        raise InputError(f"{name} {list(values.shape)} do not fit a scene of {view.n_gaussians} Gaussians")


def _check_codes(view: View, indices: Tensor, weights: Tensor) -> None:
    _check_rows(view, weights, 3, "code weights")
    if indices.shape != weights.shape:
        raise InputError(f"code indices {list(indices.shape)} and weights {list(weights.shape)} differ")
