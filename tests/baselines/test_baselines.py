"""Dense uplift against its definition, pixel by pixel."""

from __future__ import annotations

import torch

from scoup import raster
from scoup.baselines.dense import dense_features, dense_relevancy
from scoup.evaluate.variants import dense_variant, sparse_variant
from scoup.field.relevancy import relevancy
from scoup.scene.codes import SparseCodes
from scoup.uplift.rasterise import region_sums
from scoup.uplift.vote import GaussianCodes
from support import small_scene, unit


def test_dense_features_are_the_weighted_mean_of_embeddings():
    gaussians, cameras, regions = small_scene(count=60, views=2)
    sums = region_sums(gaussians, cameras, regions)
    stacked = [regions.embeddings(level)[0] for level in regions.levels]
    for s, level in enumerate(regions.levels):
        expected = torch.zeros(60, 16)
        for camera in cameras:
            region_map = regions.load(camera.name, level)
            weights, _ = raster.render_channels(raster.project(gaussians, camera), torch.eye(60))
            has = region_map.labels >= 0
            expected += weights[has].T @ region_map.embeddings[region_map.labels[has].long()]
        actual = dense_features(sums, stacked, s)
        assert torch.allclose(actual, unit(expected), atol=1e-4)


def test_dense_relevancy_is_that_of_the_rendered_features():
    gaussians, cameras, _ = small_scene(count=60, views=1)
    features = unit(torch.randn(60, 16))
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    view = raster.project(gaussians, cameras[0])
    image = unit(raster.render_channels(view, features)[0])
    expected = relevancy(
        (image @ queries.T).permute(2, 0, 1)[None], (image @ canonical.T).permute(2, 0, 1)[None]
    )
    assert torch.allclose(dense_relevancy(view, features, queries, canonical), expected[0], atol=1e-6)


def whole_codes(accumulators: torch.Tensor) -> GaussianCodes:
    """Codes that keep every entry of [N, S, L]."""
    levels = [SparseCodes.from_dense(level, accumulators.shape[2]) for level in accumulators.unbind(1)]
    indices, weights = ([getattr(level, name) for level in levels] for name in ("indices", "weights"))
    return GaussianCodes(torch.stack(indices, 1), torch.stack(weights, 1))


def test_with_an_atom_for_every_region_sparse_uplift_is_dense_uplift():
    """Codes that are exact and a vote that keeps all lose nothing."""
    gaussians, cameras, regions = small_scene(count=80, views=2, regions=4)
    sums = region_sums(gaussians, cameras, regions)
    stacked = [regions.embeddings(level)[0] for level in regions.levels]
    accumulators = torch.stack([torch.from_numpy(sums.matrix(s).toarray()) for s in range(3)], 1)
    codes = whole_codes(accumulators)
    sparse = sparse_variant("sparse", gaussians, codes, torch.stack(stacked), "inria", all_kept=True)
    dense = dense_variant("dense", sums, stacked)
    # Per Gaussian the two differ by the length of its mean embedding, which dense uplift normalises away; a scene
    # of one Gaussian has no such weights to differ in.
    one = torch.zeros(80, dtype=torch.bool)
    one[int(accumulators.sum((1, 2)).argmax())] = True
    alone = gaussians.select(one)
    single = sparse_variant(
        "sparse", alone, whole_codes(accumulators[one]), torch.stack(stacked), "inria", all_kept=True
    )
    view = raster.project(alone, cameras[0])
    queries = unit(torch.randn(3, 16))
    image = single.ask(cameras[0], view, queries, queries)
    features = [dense_features(sums, stacked, s)[one] for s in range(3)]
    expected = torch.stack([dense_relevancy(view, each, queries, queries) for each in features])
    assert torch.allclose(image, expected, atol=2e-3)  # float16 weights
    assert dense.bytes_per_gaussian == 3 * 16 * 4
    assert sparse.bytes_per_gaussian == 3 * 8 * 2
