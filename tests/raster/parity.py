"""Where two backends may differ, and by how much.

Backends round differently. At a threshold (alpha near 1/255, transmittance near the stop bound) the rounding decides
whether a Gaussian is drawn at a pixel: a flip. Everywhere else answers agree to a tolerance. A flip is not taken on
trust: ``close_calls`` evaluates a pixel in float64 and counts the decisions that are too close to call.
"""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from scoup import raster
from scoup.base import native_core
from scoup.base.native import missing_reason
from scoup.raster.combinations import ViewSums
from scoup.raster.presets import raster_preset
from scoup.raster.projection import project_gaussians
from scoup.scene import Camera, Gaussians, index_dtype
from support import random_labels, unit

Pair = tuple[raster.Projection, raster.Projection]

RELATIVE = 1e-5
# Of a sum of float32 terms, in units of what the values span.
ABSOLUTE = 2e-6
# A decision within this share of its threshold is too close to call in float32.
MARGIN = 1e-4
# What one flip may change in a pixel, in units of what the values span: a Gaussian of alpha 1/255 more or less; and
# the last one before the stop, which has alpha T <= 0.99e-2 where T (1 - alpha) = 1e-4, with the 1e-4 behind it.
FLIP_SIZE = 1 / 255 + 0.99e-2 + 1e-4
# Pixels of a real view that flip visibly. Measured on every instruction set: 1.4e-5 of a view of 960 x 720 at most;
# they change by 1.8e-3 at most.
FLIP_SHARE = 3e-5

needs_native = pytest.mark.skipif(
    native_core() is None, reason=f"needs the compiled core: {missing_reason()}"
)
# Those of a CPU; kernels of a GPU are held to the reference by test_gpu.py.
BACKENDS = [pytest.param("native", marks=needs_native), "reference"]


def both(gaussians: Gaussians, camera: Camera, preset: str = "inria") -> Pair:
    """(native, reference) projections of a scene."""
    native, reference = (raster.project(gaussians, camera, preset, name) for name in ("native", "reference"))
    return native, reference


def close_calls(gaussians: Gaussians, camera: Camera, preset: str, rows: Tensor, columns: Tensor) -> Tensor:
    """[P] int64: how many decisions at each pixel are too close to call, by an evaluation in float64 without tiles."""
    constants, projected = raster_preset(preset), project_gaussians(gaussians, camera, raster_preset(preset))
    _, xy, yy = projected.covariances.unbind(1)
    found = []
    at_once = max(1, 4_000_000 // max(1, len(projected)))
    for y, x in zip(rows.split(at_once), columns.split(at_once), strict=True):
        dx = x[:, None] + 0.5 - projected.means2d[:, 0]
        dy = y[:, None] + 0.5 - projected.means2d[:, 1]
        squared = (dx - xy / yy * dy) ** 2 * (yy / projected.determinants) + dy**2 / yy
        alpha = (projected.opacities * torch.exp(-0.5 * squared)).clamp(max=constants.alpha_max)
        close = (alpha * 255 - 1).abs() < MARGIN
        alpha[alpha * 255 < 1 - MARGIN] = 0
        after = torch.cumprod(1 - alpha, 1)
        close |= (alpha > 0) & ((after / constants.stop - 1).abs() < MARGIN)
        before = torch.nn.functional.pad(after, (1, 0), value=1.0)[:, :-1]
        found.append((close & (before > constants.stop * (1 - MARGIN))).sum(1))
    return torch.cat(found) if found else rows.new_zeros(0)


def sure_pixels(gaussians: Gaussians, camera: Camera, preset: str = "inria") -> Tensor:
    """[H, W] bool: pixels without a close call. For small scenes."""
    rows, columns = torch.meshgrid(torch.arange(camera.height), torch.arange(camera.width), indexing="ij")
    calls = close_calls(gaussians, camera, preset, rows.flatten(), columns.flatten())
    return (calls == 0).view(camera.height, camera.width)


def span_of(values: Tensor) -> float:
    """How far apart values, and nothing painted at all, may lie."""
    return float(values.amax().clamp(min=0) - values.amin().clamp(max=0)) if values.numel() else 1.0


def beyond(actual: Tensor, expected: Tensor, span: float = 1.0) -> Tensor:
    """Boolean: entries that differ by more than the tolerance, or are not numbers."""
    return ~((actual - expected).abs() <= RELATIVE * expected.abs() + ABSOLUTE * max(span, 1e-30))


def assert_close(actual: Tensor, expected: Tensor, span: float = 1.0, where: Tensor | None = None) -> None:
    """Agreement within the tolerance; ``where`` [H, W] limits it to some pixels of [H, W, ...]."""
    assert actual.shape == expected.shape
    assert actual.dtype == expected.dtype
    if where is not None:
        actual, expected = actual[where], expected[where]
    bad = beyond(actual, expected, span)
    if bad.any():
        worst = float((actual - expected).abs()[bad].max())
        raise AssertionError(f"{int(bad.sum())} of {bad.numel()} entries differ, by up to {worst:.3g}")


def few(flipped: Tensor) -> bool:
    """Whether no more pixels of a real view flip than usual; two of a small view are no surprise."""
    return int(flipped.sum()) <= max(2, FLIP_SHARE * flipped.numel())


def explained_flips(
    gaussians: Gaussians, camera: Camera, preset: str, actual: Tensor, expected: Tensor, span: float = 1.0
) -> Tensor:
    """[H, W] bool: the flipped pixels of an image [H, W, C]. Each must have a close call and change by what its flips
    may do."""
    pixels = beyond(actual, expected, span).any(2)
    rows, columns = torch.nonzero(pixels, as_tuple=True)
    calls = close_calls(gaussians, camera, preset, rows, columns)
    sizes = (actual - expected).abs().amax(2)[pixels] / span
    assert (calls > 0).all(), (
        f"pixels {torch.stack([rows, columns], 1)[calls == 0][:5].tolist()} differ, unexplained"
    )
    assert (sizes <= FLIP_SIZE * calls).all(), f"a flip changes a pixel by {float(sizes.max()):.3g}"
    return pixels


def painted(projection: raster.Projection, values: Tensor) -> Tensor:
    """[H, W, C + 1], on the CPU: what is painted of values [N, C], and alpha."""
    image, alpha = raster.render_channels(projection, values)
    return torch.cat([image, alpha[..., None]], 2).cpu()


def assert_channels_agree(
    projections: Pair, scene: tuple[Gaussians, Camera], preset: str, values: Tensor, device: str = "cpu"
) -> Tensor:
    """What is painted agrees with the reference, the second, where pixels are sure; flips explain the rest. Returns
    what the first paints."""
    actual, expected = painted(projections[0], values.to(device)), painted(projections[1], values)
    span = max(1.0, span_of(values))
    assert_close(actual, expected, span, sure_pixels(*scene, preset))
    explained_flips(*scene, preset, actual, expected, span)
    assert not actual[actual[..., -1] == 0].any()
    return actual


def labels_at(scene: tuple[Gaussians, Camera], preset: str, levels: int, n_regions: int, seed: int) -> Tensor:
    """[S, H, W] int32: labels of the sure pixels; with more regions than pixels each has its own, of an even seed with
    holes between them."""
    height, width = scene[1].height, scene[1].width
    if n_regions > height * width:
        generator = torch.Generator().manual_seed(seed)
        labels = torch.rand(levels, height * width, generator=generator).argsort(1).int()
        holes = torch.rand(labels.shape, generator=generator) < 0.5
        labels = labels.masked_fill(holes & (seed % 2 == 0), -1).view(levels, height, width)
    else:
        labels = random_labels(levels, height, width, n_regions, seed)
    labels[:, ~sure_pixels(*scene, preset)] = -1
    return labels


def random_codes(
    count: int, levels: int, k: int, n_atoms: int, seed: int, repeated: bool = False
) -> tuple[Tensor, ...]:
    """indices, weights [N, S, K], codebook [S, L, 24], queries [Q, 24]. A third of the Gaussians have no code; a code
    may have an atom ``repeated``."""
    generator = torch.Generator().manual_seed(seed)
    weights = torch.rand(count, levels, k, generator=generator).sort(dim=2, descending=True).values
    weights[torch.rand(count, generator=generator) < 0.3] = 0
    if repeated:
        indices = torch.randint(n_atoms, (count, levels, k), generator=generator)
    else:
        indices = torch.rand(count, levels, n_atoms, generator=generator).argsort(2)[..., :k]
        indices = torch.nn.functional.pad(indices, (0, max(0, k - n_atoms)))
        weights[..., n_atoms:] = 0
    codebook = torch.randn(levels, n_atoms, 24, generator=generator) * 3
    codebook += seed % 2 * 3  # of an odd seed alike
    queries = unit(torch.randn(1 + seed % 20, 24, generator=generator))
    return indices.to(index_dtype(n_atoms)), weights, codebook, queries


def assert_codes_agree(
    projections: Pair, sure: Tensor, codes: tuple[Tensor, ...], device: str = "cpu"
) -> Tensor:
    """Coefficients, cosines, norms and features agree with the reference's, the second, at ``sure`` [H, W] pixels.
    Returns the coefficients of the reference."""
    (levels, n_atoms, _), codebook, k = codes[2].shape, codes[2].float(), codes[0].shape[2]
    there, (projection, reference) = [part.to(device) for part in codes], projections
    terms = raster.render_codes(reference, codes[0], codes[1], n_atoms)
    found = raster.render_codes(projection, there[0], there[1], n_atoms).cpu()
    assert found.shape == (levels, *sure.shape, n_atoms)
    assert_close(found.movedim(0, 2), terms.movedim(0, 2), max(1, k / 4), sure)
    # Where atoms cancel, so do digits: a feature is known to the share that is left of its terms.
    most = (terms * codebook.norm(dim=2)[:, None, None]).sum(3)
    left = torch.einsum("shwl,sld->shwd", terms, codebook).norm(dim=3) / most.clamp(min=1e-30)
    whole, unpainted = (left > 0.1).all(0) & sure, (terms == 0).all(3) & sure

    cosines = raster.render_cosines(projection, *there)
    assert cosines.shape == (levels, len(codes[3]), *sure.shape)
    assert torch.isfinite(cosines).all()
    assert (cosines.abs() <= 1 + 1e-3).all()
    again, norms = raster.render_cosines_and_norms(projection, *there)
    features = raster.render_features(projection, *there[:3])
    expected, known = raster.render_cosines_and_norms(reference, *codes)
    decoded = raster.render_features(reference, *codes[:3])
    last = max(1.0, float(most.amax()))
    for actual, wanted, span in (
        (cosines.movedim(1, 3), expected.movedim(1, 3), 5.0), (again.movedim(1, 3), expected.movedim(1, 3), 5.0),
        (norms, known, 5 * last), (features, decoded, 5.0),
    ):  # fmt: skip
        actual = actual.cpu()
        assert_close(actual.movedim(0, 2), wanted.movedim(0, 2), span, whole)
        assert not actual[unpainted].any()
    return terms


def assert_same_sums(actual: ViewSums, expected: ViewSums, span: float = 1.0) -> None:
    """Region sums agree; a pair that only one side has must weigh next to nothing."""
    assert torch.equal(actual.table.cpu(), expected.table.cpu())
    count = max(1, len(expected.table))
    pairs = []
    for sums in (actual, expected):
        assert [part.dtype for part in (sums.gaussian, sums.combination)] == [torch.int32] * 2
        assert sums.weight.dtype == torch.float32
        assert (sums.weight > 0).all()
        assert ((sums.combination >= 0) & (sums.combination < count)).all()
        pair = (sums.gaussian.long() * count + sums.combination).cpu()
        assert (pair[1:] > pair[:-1]).all()  # sorted, each once
        pairs.append(pair)
    union = torch.unique(torch.cat(pairs))
    dense = [torch.zeros(len(union)) for _ in pairs]
    for side, pair, sums in zip(dense, pairs, (actual, expected), strict=True):
        side[torch.searchsorted(union, pair)] = sums.weight.cpu()
    assert_close(dense[0], dense[1], span)


def same_bytes(one: ViewSums, other: ViewSums) -> bool:
    """Whether region sums are equal to the last bit."""
    names = ("gaussian", "combination", "weight", "table")
    return all(torch.equal(getattr(one, name), getattr(other, name)) for name in names)
