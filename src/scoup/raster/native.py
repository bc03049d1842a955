"""The rasteriser on a CPU: the C++ core in native/, behind the same functions as ``reference``.

Everything runs on ``torch.get_num_threads()`` threads; the result does not depend on their number.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base import MOST_ROWS_IN_MEMORY, required_core
from scoup.raster.combinations import CombinedLabels
from scoup.raster.presets import RasterPreset
from scoup.scene import Camera, Gaussians, check_atoms, code_arrays, index_dtype, stable_products


@dataclass(frozen=True, eq=False)
class NativeProjection:
    """A scene as one camera sees it: projected, binned and sorted."""

    n_gaussians: int  # of the scene
    width: int  # pixels
    height: int
    preset: RasterPreset
    # Of the compiled core: 64 bytes per Gaussian of the chunks that may be seen, and 4 bytes per pair of a Gaussian and
    # a tile of 16 x 16 pixels that it reaches.
    handle: Any

    backend = "native"


PREPARES = True  # by ``make_scene``, and the order of the rows matters to caches


def make_scene(gaussians: Gaussians, ties: Tensor | None = None, many_views: bool = False) -> Any:
    """Return the Gaussians as the compiled core takes them. It refers to the tensors: later changes may be seen.

    ``ties`` [N] int64 decides between equal depths; by default the rows do. ``many_views`` computes what does not
    depend on the camera once, and passes over chunks of 8,192 rows that a camera cannot see, for 48 bytes per Gaussian
    more, up to ``MOST_ROWS_IN_MEMORY`` of them.
    """
    with required_core() as core:
        return core.Scene(
            _array(gaussians.means),
            _array(gaussians.quats),
            _array(gaussians.scales),
            _array(gaussians.opacities),
            None if ties is None else _array(ties, torch.int64),
            many_views,
            len(gaussians) <= MOST_ROWS_IN_MEMORY,
            torch.get_num_threads(),
        )


def project(
    gaussians: Gaussians, camera: Camera, preset: RasterPreset, scene: Any | None = None
) -> NativeProjection:
    """See ``raster.project``; ``scene`` is from ``make_scene``."""
    scene = make_scene(gaussians) if scene is None else scene
    with required_core() as core:
        handle = core.project(
            scene,
            _array(camera.viewmat[:3], torch.float64),
            (camera.fx, camera.fy, camera.cx, camera.cy),
            camera.width,
            camera.height,
            (preset.near, preset.alpha_max, preset.stop),
            preset.stop_inclusive,
            preset.centred_clamp,
            torch.get_num_threads(),
        )
    return NativeProjection(len(gaussians), camera.width, camera.height, preset, handle)


def region_sums(projection: NativeProjection, combined: CombinedLabels) -> tuple[Tensor, Tensor, Tensor]:
    """See ``raster.region_sums``."""
    with required_core() as core:
        entries = core.region_sums(
            projection.handle, _array(combined.map, torch.int32), torch.get_num_threads()
        )
    gaussian, combination, weight = (torch.from_numpy(array) for array in entries)
    return gaussian, combination, weight


def render_channels(projection: NativeProjection, values: Tensor) -> tuple[Tensor, Tensor]:
    """See ``raster.render_channels``."""
    with required_core() as core:
        image, alpha = core.render_channels(projection.handle, _array(values), torch.get_num_threads(), True)
    return torch.from_numpy(image), torch.from_numpy(alpha)


def render_values(projection: NativeProjection, values: Tensor) -> Tensor:
    """See ``raster.render_values``."""
    with required_core() as core:
        image, _ = core.render_channels(projection.handle, _array(values), torch.get_num_threads(), False)
    return torch.from_numpy(image)


def render_codes(projection: NativeProjection, indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
    """See ``raster.render_codes``."""
    table = _code_table(indices, weights, n_atoms)
    with required_core() as core:
        return torch.from_numpy(
            core.render_codes(projection.handle, *table, n_atoms, torch.get_num_threads())
        )


def render_cosines_and_norms(
    projection: NativeProjection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> tuple[Tensor, Tensor]:
    """See ``raster.render_cosines_and_norms``. No map of coefficients is kept."""
    table = _code_table(indices, weights, codebook.shape[1])
    levels, words = codebook.cpu(), queries.cpu()
    with required_core() as core:
        grams = _array(torch.stack([stable_products(atoms, atoms) for atoms in levels]))
        scores = _array(torch.stack([stable_products(atoms, words) for atoms in levels]))
        cosines, norms = core.render_cosines(
            projection.handle, *table, grams, scores, torch.get_num_threads()
        )
    return torch.from_numpy(cosines), torch.from_numpy(norms)


def _array(tensor: Tensor, dtype: torch.dtype = torch.float32) -> np.ndarray:
    """Return a contiguous CPU array; no copy where the tensor is one already."""
    return tensor.detach().to("cpu", dtype).contiguous().numpy()


def _code_table(indices: Tensor, weights: Tensor, n_atoms: int) -> tuple[np.ndarray, np.ndarray]:
    """Return indices as uint8 or uint16, weights as float32 or the bits of float16: the forms of stored fields.

    They are not searched for atoms beyond the codebook: the core refuses those it meets.
    """
    if indices.dtype not in (torch.uint8, torch.uint16):
        check_atoms(indices, n_atoms)
        indices = indices.to(index_dtype(n_atoms))
    return code_arrays(indices, weights)
