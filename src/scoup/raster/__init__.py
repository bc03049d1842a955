"""The rasteriser's contract: look once, ask often, all levels in one pass.

``look`` projects, bins and sorts a scene for one camera. The other functions take its view and answer; they all
use the same blending weights e = alpha * transmittance of each Gaussian at each pixel (method.md, stage 2), so
what is lifted is exactly what is rendered. Gaussians that are not finite are never drawn; a pixel nothing paints
is zero.

A backend is one module with these functions. It is chosen by the device of the tensors, or by name:

* ``triton``: kernels for tensors on a GPU;
* ``native``: the compiled core, SIMD and threads, for tensors on a CPU;
* ``reference``: plain torch, any device; what the others are tested against.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import os
import warnings
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias, Union

import torch
from torch import Tensor

from scoup.base.errors import InputError, ScoupWarning, UnknownNameError
from scoup.base.native import missing_reason, native_core, warn_once_if_missing
from scoup.base.triton import why_not
from scoup.raster.combinations import CombinedLabels as CombinedLabels
from scoup.raster.combinations import combine as combine
from scoup.raster.native import NativeProjection
from scoup.raster.ordering import morton_order as morton_order
from scoup.raster.ordering import restored as restored
from scoup.raster.presets import RASTER_PRESETS as RASTER_PRESETS
from scoup.raster.presets import RasterPreset as RasterPreset
from scoup.raster.presets import raster_preset
from scoup.raster.reference import ReferenceProjection
from scoup.raster.spherical_harmonics import view_colors as view_colors
from scoup.raster.view_sums import ViewSums as ViewSums
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians

if TYPE_CHECKING:
    from scoup.raster.triton.projection import TritonProjection

Projection: TypeAlias = Union[ReferenceProjection, NativeProjection, "TritonProjection"]

BACKENDS = {
    "native": "scoup.raster.native",
    "reference": "scoup.raster.reference",
    "triton": "scoup.raster.triton.rendering",
}

_ONLY_ON = {"native": "cpu", "triton": "cuda"}  # what torch calls AMD's devices, too


def serves(name: str, device: torch.device) -> bool:
    """Whether a backend is for tensors on this device; whether it works there is another matter."""
    interpreted = name == "triton" and os.environ.get("TRITON_INTERPRET") == "1"
    return interpreted or _ONLY_ON.get(name, device.type) == device.type


def default_backend(device: torch.device) -> str:
    """The fastest backend that serves tensors on this device; warns once where what makes it fast is missing."""
    if device.type == "cuda":
        reason = why_not(device)
        if reason is None:
            return "triton"
        _warn_once_of_triton(reason)
        return "reference"
    if device.type != "cpu":
        return "reference"
    if native_core() is None:
        warn_once_if_missing()
        return "reference"
    return "native"


@functools.cache
def _warn_once_of_triton(reason: str) -> None:
    warnings.warn(
        f"rasterising on the GPU takes the slow reference path: {reason}",
        ScoupWarning,
        stacklevel=3,
    )


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """A scene made ready for many views. Made by ``prepare``.

    Attributes:
        gaussians: the rows in the order that suits the backend; of their colours only the constant part.
        order: [N] int64, the row of the original scene that each of them is; None where nothing was moved.
        backend: its name.
        handle: what the backend has worked out for all views, 48 bytes a Gaussian with "native"; None if nothing.
    """

    gaussians: Gaussians
    order: Tensor | None
    backend: str
    handle: Any = None

    def restored(self, rows: Tensor) -> Tensor:
        """``rows`` [N, ...], one for each Gaussian of this scene, in the order of the original scene."""
        return rows if self.order is None else restored(rows, self.order)


def prepare(gaussians: Gaussians, backend: str | None = None) -> PreparedScene:
    """Bring the rows of a scene into the order that suits a backend, and work out what all views share; worth it where
    many views follow.

    Views of it know the Gaussians by their new places: region sums, and values given to them, are in that order, too.
    They show exactly the same: equal depths go by the original rows.

    Args:
        gaussians: N Gaussians.
        backend: as for ``look``.
    """
    name, module = _backend(backend, gaussians.device)
    bare = dataclasses.replace(gaussians, sh=gaussians.sh[:, :1])
    if not module.PREPARES:
        return PreparedScene(bare, None, name)
    order = morton_order(gaussians.means)
    moved = bare.select(order)
    return PreparedScene(moved, order, name, module.make_scene(moved, order, many_views=True))


def project(
    gaussians: Gaussians | PreparedScene,
    camera: Camera,
    preset: str | RasterPreset = "inria",
    backend: str | None = None,
) -> Projection:
    """Prepare a scene for one camera: project, bin and sort.

    Args:
        gaussians: N Gaussians, or the same prepared for many views (the backend is then the one of ``prepare``).
        camera: the pinhole view.
        preset: rasteriser constants: "inria" (default) or "gsplat".
        backend: name of a backend; by default the fastest for the tensors' device.

    Returns:
        A view for the functions below. It keeps no reference to colours or codes.

    Raises:
        UnknownNameError: no preset or backend has that name.
        InputError: the backend does not serve the tensors' device, or is not built.
    """
    constants = raster_preset(preset)
    if isinstance(gaussians, PreparedScene):
        if backend not in (None, gaussians.backend):
            raise InputError(f"the scene was prepared for the backend {gaussians.backend!r}, not {backend!r}")
        module = importlib.import_module(BACKENDS[gaussians.backend])
        if gaussians.handle is None:
            return module.project(gaussians.gaussians, camera, constants)
        return module.project(gaussians.gaussians, camera, constants, gaussians.handle)
    return _backend(backend, gaussians.device)[1].project(gaussians, camera, constants)


def region_sums(view: Projection, labels: Tensor | CombinedLabels) -> ViewSums:
    """How much each Gaussian paints of each region: A[i, r] = sum of e_i over the pixels of r (method.md, stage 2).

    Args:
        view: from ``look``.
        labels: [S, H, W] integer region of each pixel at each level, -1 for none; or what ``combine`` made of them.

    Returns:
        Entries (Gaussian, combination of regions over all levels, weight), and the table of combinations, on the
        view's device. Gaussians that paint no region have none.

    Raises:
        InputError: the labels do not have the view's size.
    """
    combined = combine(labels) if isinstance(labels, Tensor) else labels
    if tuple(combined.map.shape) != (view.height, view.width):
        raise InputError(
            f"labels of {' x '.join(map(str, combined.map.shape))} pixels do not fit a view of {view.height} x "
            f"{view.width} (H x W)"
        )
    gaussian, combination, weight = _backend_of(view).region_sums(view, combined.map)
    return ViewSums(gaussian, combination, weight, combined.table.to(weight.device))


def render_channels(view: Projection, values: Tensor) -> tuple[Tensor, Tensor]:
    """Render any per-Gaussian values.

    Args:
        view: from ``look``.
        values: [N, C] float32.

    Returns:
        image [H, W, C] = sum of e_i * values_i, and alpha [H, W] = sum of e_i (one minus the transmittance left).
    """
    _check_rows(view, values, 2, "values")
    return _backend_of(view).render_channels(view, values.float())


def render_codes(view: Projection, indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
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
    return _backend_of(view).render_codes(view, indices, weights, n_atoms)


def render_cosines(
    view: Projection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> Tensor:
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
    _check_cosines(view, indices, weights, codebook, queries)
    return _backend_of(view).render_cosines(view, indices, weights, codebook.float(), queries.float())


def render_cosines_and_norms(
    view: Projection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> tuple[Tensor, Tensor]:
    """``render_cosines``, and the norm of each pixel's rendered feature, which no query changes.

    A cosine is a sum over Gaussians, W A, by this norm: with it at hand, another query is a render of few channels
    (``codes.code_scores``, then ``render_channels``).

    Args:
        view: from ``look``.
        indices: [N, S, K] sparse codes.
        weights: [N, S, K], not negative.
        codebook, queries: see ``render_cosines``.

    Returns:
        cosines [S, Q, H, W] float32, and norms [S, H, W] float32, sqrt(W G W^T); zero where no code reaches.
    """
    _check_cosines(view, indices, weights, codebook, queries)
    render = _backend_of(view).render_cosines_and_norms
    return render(view, indices, weights, codebook.float(), queries.float())


def render_features(view: Projection, indices: Tensor, weights: Tensor, codebook: Tensor) -> Tensor:
    """Decoded features of each pixel, for those who want the map: S x H x W x D numbers.

    Args:
        view: from ``look``.
        indices, weights: [N, S, K] sparse codes.
        codebook: [S, L, D] float32.

    Returns:
        [S, H, W, D] float32 of unit norm; zero where nothing is rendered.
    """
    _check_codes(view, indices, weights)
    if codebook.dim() != 3 or codebook.shape[0] != indices.shape[1]:
        raise InputError(f"codebook {list(codebook.shape)} does not fit {indices.shape[1]} levels")
    return _backend_of(view).render_features(view, indices, weights, codebook.float())


def render_colors(
    gaussians: Gaussians, camera: Camera, view: Projection | None = None, background: float = 0.0
) -> Tensor:
    """[H, W, 3] float32 colour render in 0..1 over a grey background; ``view`` saves looking again."""
    view = view if view is not None else project(gaussians, camera)
    image, alpha = render_channels(view, view_colors(gaussians, camera))
    return (image + (1.0 - alpha)[..., None] * background).clamp(0, 1)


def _backend(name: str | None, device: torch.device) -> tuple[str, ModuleType]:
    """Name and module of the backend wanted, or of the default."""
    name = name or default_backend(device)
    if name not in BACKENDS:
        raise UnknownNameError("raster backend", name, BACKENDS)
    if name == "native" and native_core() is None:
        raise InputError(f"the backend 'native' cannot be used: {missing_reason()}")
    if not serves(name, device):
        place = "a GPU" if name == "triton" else "a CPU"
        raise InputError(f"the backend {name!r} serves tensors on {place}, these are on {device}")
    reason = why_not(device) if name == "triton" else None
    if reason is not None:
        raise InputError(f"the backend 'triton' cannot be used: {reason}")
    return name, importlib.import_module(BACKENDS[name])


def _backend_of(view: Projection) -> ModuleType:
    return importlib.import_module(BACKENDS[view.backend])


def _check_rows(view: Projection, values: Tensor, dims: int, name: str) -> None:
    if values.dim() != dims or values.shape[0] != view.n_gaussians:
        raise InputError(f"{name} {list(values.shape)} do not fit a scene of {view.n_gaussians} Gaussians")


def _check_codes(view: Projection, indices: Tensor, weights: Tensor) -> None:
    _check_rows(view, weights, 3, "code weights")
    if indices.shape != weights.shape:
        raise InputError(f"code indices {list(indices.shape)} and weights {list(weights.shape)} differ")


def _check_cosines(
    view: Projection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> None:
    _check_codes(view, indices, weights)
    if (
        codebook.dim() != 3
        or codebook.shape[0] != indices.shape[1]
        or queries.shape[1:] != codebook.shape[2:]
    ):
        raise InputError(
            f"codebook {list(codebook.shape)} and queries {list(queries.shape)} do not fit {indices.shape[1]} levels"
        )
