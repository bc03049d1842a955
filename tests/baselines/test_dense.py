"""Dense uplift against its definition, pixel by pixel."""

from __future__ import annotations

import torch

from scoup import raster
from scoup.field import FieldInfo, relevancy
from scoup.query import LanguageField
from scoup.scene import SparseCodes
from scoup.uplift import region_sums
from scoup_lab.baselines.dense import dense_features, mean_features
from scoup_lab.baselines.fitted import FittedChannels, FittedField
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from support import small_scene, unit


def test_features_are_sums_and_means_of_embeddings() -> None:
    """``dense_features`` of unit norm; ``mean_features`` as long as the paper's Eq. 3 makes them."""
    gaussians, cameras, regions = small_scene(count=60, views=2)
    sums = region_sums(gaussians, cameras, regions)
    for s, level in enumerate(regions.levels):
        rows, _ = regions.embeddings(level)
        summed, total = torch.zeros(60, 16), torch.zeros(60)
        for camera in cameras:
            region_map = regions.load(camera.name, level)
            weights, _ = raster.render_channels(raster.project(gaussians, camera), torch.eye(60))
            has = region_map.labels >= 0
            summed += weights[has].T @ region_map.embeddings[region_map.labels[has].long()]
            total += weights[has].sum(0)
        assert torch.allclose(dense_features(sums, rows, s), unit(summed), atol=1e-4)
        found, seen = mean_features(sums, rows, s), total > 1e-4
        assert torch.allclose(found[seen], (summed / total[:, None])[seen], atol=1e-4)
        lengths = found.norm(dim=1)
        assert lengths.max() <= 1 + 1e-5
        assert lengths[seen].min() < 0.9  # regions differ
        assert not found[total == 0].any()


def test_relevancy_is_that_of_the_rendered_features() -> None:
    gaussians, cameras, regions = small_scene(count=60, views=1)
    scene = RasterisedScene(gaussians, cameras, regions)
    fitted = METHODS["dense"].fit(scene)
    assert isinstance(fitted, FittedChannels)
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    projection = raster.project(gaussians, cameras[0])
    found = fitted.relevancy(projection, queries, canonical)
    for level, features in enumerate(fitted.channels):
        image = unit(raster.render_channels(projection, features)[0])
        expected = relevancy(
            (image @ queries.T).permute(2, 0, 1)[None], (image @ canonical.T).permute(2, 0, 1)[None]
        )
        assert torch.allclose(found[level], expected[0], atol=1e-6)


def every_atom_kept(accumulators: torch.Tensor, codebook: torch.Tensor) -> FittedField:
    """The field of codes that keep every entry of [N, S, L]."""
    levels = [SparseCodes.from_dense(level, accumulators.shape[2]) for level in accumulators.unbind(1)]
    indices, weights = ([getattr(level, name) for level in levels] for name in ("indices", "weights"))
    info = FieldInfo(("s", "m", "l"), "", "", len(accumulators), "inria")
    field = LanguageField(torch.stack(indices, 1), torch.stack(weights, 1), codebook, info)
    return FittedField(field, all_kept=True)


def test_with_an_atom_for_every_region_sparse_uplift_is_dense_uplift() -> None:
    """Codes that are exact and a vote that keeps all lose nothing."""
    gaussians, cameras, regions = small_scene(count=80, views=2, regions=4)
    scene = RasterisedScene(gaussians, cameras, regions)
    dense = METHODS["dense"].fit(scene)
    assert isinstance(dense, FittedChannels)
    sums, codebook = scene.region_sums(), torch.stack(list(scene.inputs().embeddings))
    accumulators = torch.stack([torch.from_numpy(sums.matrix(s).toarray()) for s in range(3)], 1)
    # Per Gaussian the two differ by the length of its mean embedding, which dense uplift normalises away; a scene
    # of one Gaussian has no such weights to differ in.
    one = torch.zeros(80, dtype=torch.bool)
    one[int(accumulators.sum((1, 2)).argmax())] = True
    projection = raster.project(gaussians.select(one), cameras[0])
    queries = unit(torch.randn(3, 16))
    single = every_atom_kept(accumulators[one], codebook).relevancy(projection, queries, queries)
    alone = FittedChannels([features[one] for features in dense.channels], dense.cosines, 0.0)
    expected = alone.relevancy(projection, queries, queries)
    assert torch.allclose(single, expected, atol=2e-3)  # float16 weights
    assert dense.bytes_per_gaussian == 3 * 16 * 4
    assert every_atom_kept(accumulators, codebook).bytes_per_gaussian == 3 * 8 * 2
