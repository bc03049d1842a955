"""The rasteriser's contract: project once, render often, all levels in one pass.

``project`` projects, bins and sorts the Gaussians for one camera. The other functions take its ``Projection``. They all
use the same blending weights e = alpha * transmittance of each Gaussian at each pixel (method.md, stage 2), so the
uplift sees exactly what is rendered. Gaussians that are not finite are never drawn; a pixel to which no Gaussian
contributes is zero.

A backend is one module with these functions, chosen by the device of the tensors or by name (``base.backends``); it has
``render_values``, ``render_cosines`` and ``render_features`` only where it is faster than by way of the others.
"""

from __future__ import annotations

import dataclasses
import importlib
from dataclasses import dataclass
from types import ModuleType
from typing import TYPE_CHECKING, Any, TypeAlias, Union

import torch
from torch import Tensor

from scoup.base import MOST_ROWS_IN_MEMORY, InputError, check_arguments, load_backend, scratch_array
from scoup.raster.combinations import CombinedLabels, ViewSums, combine, merge
from scoup.raster.decoding import cosines_and_norms, view_colors
from scoup.raster.native import NativeProjection
from scoup.raster.ordering import AT_A_TIME, morton_codes, morton_order, restored
from scoup.raster.presets import RASTER_PRESETS, RasterPreset, raster_preset
from scoup.raster.reference import ReferenceProjection
from scoup.scene import Camera, Gaussians

if TYPE_CHECKING:
    from scoup.raster.triton.projection import TritonProjection

__all__ = [
    "BACKENDS",
    "RASTER_PRESETS",
    "CombinedLabels",
    "PreparedGaussians",
    "Projection",
    "ViewSums",
    "combine",
    "cosines_and_norms",
    "merge",
    "morton_codes",
    "morton_order",
    "prepare_gaussians",
    "project",
    "raster_preset",
    "region_sums",
    "render_channels",
    "render_codes",
    "render_colors",
    "render_cosines",
    "render_cosines_and_norms",
    "render_features",
    "render_values",
    "restored",
    "view_colors",
]

Projection: TypeAlias = Union[ReferenceProjection, NativeProjection, "TritonProjection"]

BACKENDS = {
    "native": "scoup.raster.native",
    "reference": "scoup.raster.reference",
    "triton": "scoup.raster.triton.rendering",
}


@dataclass(frozen=True, eq=False)
class PreparedGaussians:
    """Gaussians made ready for many projections by ``prepare_gaussians``."""

    gaussians: Gaussians  # in the order that suits the backend; of their colours only the constant part
    order: Tensor | None  # [N] int64, the row of each in the original scene; None where nothing was moved
    backend: str  # its name
    handle: Any = None  # data of the backend for all projections, 48 bytes per Gaussian with "native"


def prepare_gaussians(gaussians: Gaussians, backend: str | None = None) -> PreparedGaussians:
    """Order the Gaussians as suits a backend (see ``project``), and compute what many projections share.

    Projections count the Gaussians in the new order: region sums and values follow it, too. The images are exactly the
    same, since equal depths go by the original rows.
    """
    name, module = load_backend(BACKENDS, gaussians.device, backend, "raster")
    bare = dataclasses.replace(gaussians, sh=gaussians.sh[:, :1])
    if not module.PREPARES:
        return PreparedGaussians(bare, None, name)
    order = morton_order(gaussians.means)
    moved = bare.select(order) if len(order) <= MOST_ROWS_IN_MEMORY else _moved_to_disk(bare, order)
    return PreparedGaussians(moved, order, name, module.make_scene(moved, order, many_views=True))


def _moved_to_disk(gaussians: Gaussians, order: Tensor) -> Gaussians:
    """Return ``gaussians.select(order)`` in temporary files; a view loads only the rows that it sees."""
    moved: dict[str, Tensor] = {}
    for name, rows in gaussians.tensors().items():
        moved[name] = torch.from_numpy(scratch_array(tuple(rows.shape), "float32"))
        for into, chunk in zip(moved[name].split(AT_A_TIME), order.split(AT_A_TIME), strict=True):
            into.copy_(rows[chunk])
    return dataclasses.replace(gaussians, **moved)


def project(
    gaussians: Gaussians | PreparedGaussians,
    camera: Camera,
    preset: str | RasterPreset = "inria",
    backend: str | None = None,
) -> Projection:
    """Project the Gaussians to one camera, bin them to tiles and sort them.

    Args:
        gaussians: N Gaussians, or the same prepared for many projections (by the backend named there).
        camera: the pinhole camera.
        preset: rasteriser constants: "inria" (default) or "gsplat", with another near plane as "inria:0.0125".
        backend: name of a backend; by default the fastest for the tensors' device.

    Returns:
        A projection for the functions below. It keeps no reference to colours or codes.

    Raises:
        UnknownNameError: the preset or backend is unknown.
        InputError: the backend does not serve the tensors' device, or is not built.

    Example:
        >>> gaussians, camera = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")[0]
        >>> projection = scoup.project(gaussians, camera)
        >>> (projection.height, projection.width) == (camera.height, camera.width)
        True
    """
    either = (Gaussians, PreparedGaussians)
    check_arguments("project", gaussians=(gaussians, either), camera=(camera, Camera))
    constants = raster_preset(preset)
    if isinstance(gaussians, PreparedGaussians):
        if backend not in (None, gaussians.backend):
            raise InputError(
                f"the Gaussians were prepared for the backend {gaussians.backend!r}, not {backend!r}"
            )
        module = importlib.import_module(BACKENDS[gaussians.backend])
        if gaussians.handle is None:
            return module.project(gaussians.gaussians, camera, constants)
        return module.project(gaussians.gaussians, camera, constants, gaussians.handle)
    module = load_backend(BACKENDS, gaussians.device, backend, "raster")[1]
    return module.project(gaussians, camera, constants)


def region_sums(projection: Projection, labels: Tensor | CombinedLabels) -> ViewSums:
    """Return the contribution of each Gaussian to each region: A[i, r], the sum of e_i over the pixels of r
    (method.md, stage 2).

    Args:
        projection: from ``project``.
        labels: [S, H, W] integer region of each pixel at each level, -1 for none; or what ``combine`` made of them.

    Returns:
        Entries (Gaussian, combination of regions over all levels, weight), and the table of combinations, on the
        projection's device. Gaussians that contribute to no region have none.

    Raises:
        InputError: the labels do not have the size of the image.
    """
    combined = combine(labels) if isinstance(labels, Tensor) else labels
    if tuple(combined.map.shape) != (projection.height, projection.width):
        raise InputError(
            f"labels of {' x '.join(map(str, combined.map.shape))} pixels do not fit an image of {projection.height} x "
            f"{projection.width} (H x W)"
        )
    gaussian, combination, weight = _backend_of(projection).region_sums(projection, combined)
    return ViewSums(gaussian, combination, weight, combined.table.to(weight.device))


def render_channels(projection: Projection, values: Tensor) -> tuple[Tensor, Tensor]:
    """Render any per-Gaussian values.

    Args:
        projection: from ``project``.
        values: [N, C] float32.

    Returns:
        image [H, W, C] = sum of e_i * values_i, and alpha [H, W] = sum of e_i (one minus the transmittance left).
    """
    _check_rows(projection, values, 2, "values")
    return _backend_of(projection).render_channels(projection, values.float())


def render_values(projection: Projection, values: Tensor) -> Tensor:
    """Return the image [H, W, C] of ``render_channels``, without alpha.

    On a CPU this takes little time where all values but those of a few Gaussians are zero: only the tiles that these
    reach are drawn.
    """
    _check_rows(projection, values, 2, "values")
    backend = _backend_of(projection)
    if hasattr(backend, "render_values"):
        return backend.render_values(projection, values.float())
    return backend.render_channels(projection, values.float())[0]


def render_codes(projection: Projection, indices: Tensor, weights: Tensor, n_atoms: int) -> Tensor:
    """Render sparse codes of all levels: the coefficient maps W^(p) of method.md, stage 3.

    Args:
        projection: from ``project``.
        indices: [N, S, K] integer atoms.
        weights: [N, S, K] float weights (float16 or float32).
        n_atoms: L.

    Returns:
        [S, H, W, L] float32.
    """
    _check_codes(projection, indices, weights)
    return _backend_of(projection).render_codes(projection, indices, weights, n_atoms)


def render_cosines(
    projection: Projection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> Tensor:
    """Return the cosine between the rendered feature of each pixel and each query, without a map of D or L channels.

    Uses cos = (W A) / sqrt(W G W^T) with A = C T^T and G = C C^T (method.md, stage 3). Pixels that no code
    reaches get 0.

    Args:
        projection: from ``project``.
        indices, weights: [N, S, K] sparse codes.
        codebook: [S, L, D] float32.
        queries: [Q, D] float32, unit norm.

    Returns:
        [S, Q, H, W] float32.
    """
    backend = _backend_of(projection)
    if not hasattr(backend, "render_cosines"):
        return render_cosines_and_norms(projection, indices, weights, codebook, queries)[0]
    _check_cosines(projection, indices, weights, codebook, queries)
    return backend.render_cosines(projection, indices, weights, codebook.float(), queries.float())


def render_cosines_and_norms(
    projection: Projection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> tuple[Tensor, Tensor]:
    """Return ``render_cosines``, and the norm of each pixel's rendered feature, which no query changes.

    A cosine is a sum over Gaussians, W A, by this norm: where it is known, another query is a render of few channels
    (``code_sums.code_scores``, then ``render_values``).

    Args:
        projection: from ``project``.
        indices: [N, S, K] sparse codes.
        weights: [N, S, K], not negative.
        codebook, queries: see ``render_cosines``.

    Returns:
        cosines [S, Q, H, W] float32, and norms [S, H, W] float32, sqrt(W G W^T); zero where no code reaches.
    """
    _check_cosines(projection, indices, weights, codebook, queries)
    render = _backend_of(projection).render_cosines_and_norms
    return render(projection, indices, weights, codebook.float(), queries.float())


def render_features(projection: Projection, indices: Tensor, weights: Tensor, codebook: Tensor) -> Tensor:
    """Render the decoded features of each pixel: S x H x W x D numbers.

    Args:
        projection: from ``project``.
        indices, weights: [N, S, K] sparse codes.
        codebook: [S, L, D] float32.

    Returns:
        [S, H, W, D] float32 of unit norm; zero where nothing is rendered.
    """
    _check_codes(projection, indices, weights)
    if codebook.dim() != 3 or codebook.shape[0] != indices.shape[1]:
        raise InputError(f"codebook {list(codebook.shape)} does not fit {indices.shape[1]} levels")
    backend, codebook = _backend_of(projection), codebook.float()
    if hasattr(backend, "render_features"):
        return backend.render_features(projection, indices, weights, codebook)
    features = []
    for level, atoms in enumerate(codebook):  # the coefficients of one level at a time
        of_level = slice(level, level + 1)
        codes = backend.render_codes(projection, indices[:, of_level], weights[:, of_level], len(atoms))[0]
        features.append(torch.nn.functional.normalize(codes @ atoms, dim=-1))
    return torch.stack(features)


def render_colors(
    gaussians: Gaussians, camera: Camera, projection: Projection | None = None, background: float = 0.0
) -> Tensor:
    """Render colours [H, W, 3] float32 in 0..1 over a grey background; ``projection`` saves projecting again."""
    projection = projection if projection is not None else project(gaussians, camera)
    image, alpha = render_channels(projection, view_colors(gaussians, camera))
    return (image + (1.0 - alpha)[..., None] * background).clamp(0, 1)


def _backend_of(projection: Projection) -> ModuleType:
    return importlib.import_module(BACKENDS[projection.backend])


def _check_rows(projection: Projection, values: Tensor, dims: int, name: str) -> None:
    if values.dim() != dims or values.shape[0] != projection.n_gaussians:
        raise InputError(
            f"{name} {list(values.shape)} do not fit a scene of {projection.n_gaussians} Gaussians"
        )


def _check_codes(projection: Projection, indices: Tensor, weights: Tensor) -> None:
    _check_rows(projection, weights, 3, "code weights")
    if indices.shape != weights.shape:
        raise InputError(f"code indices {list(indices.shape)} and weights {list(weights.shape)} differ")


def _check_cosines(
    projection: Projection, indices: Tensor, weights: Tensor, codebook: Tensor, queries: Tensor
) -> None:
    _check_codes(projection, indices, weights)
    if (
        codebook.dim() != 3
        or codebook.shape[0] != indices.shape[1]
        or queries.shape[1:] != codebook.shape[2:]
    ):
        raise InputError(
            f"codebook {list(codebook.shape)} and queries {list(queries.shape)} do not fit {indices.shape[1]} levels"
        )
