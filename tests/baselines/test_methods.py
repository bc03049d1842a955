"""The systems compared with: each makes something that can be asked, from one scene of random regions."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from scoup import raster
from scoup.base.errors import InputError, UnknownNameError
from scoup.baselines.autoencoder import AutoencoderSettings, fit_autoencoder
from scoup.baselines.dense import dense_features
from scoup.baselines.methods import METHODS, MethodSettings, find_method
from scoup.baselines.pixel_rules import gathered_sums
from scoup.field.relevancy import relevancy
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import region_sums
from support import small_scene, unit

SETTINGS = MethodSettings(
    build=BuildSettings(n_atoms=8, effort="fast"),
    autoencoder=AutoencoderSettings(epochs=2, encoder=(8, 3), decoder=(8,)),
)


@pytest.mark.parametrize("name", list(METHODS))
def test_every_method_can_be_asked(name: str) -> None:
    gaussians, cameras, regions = small_scene(count=60, views=3)
    method = find_method(name)
    if method.gather is None:
        sums = region_sums(gaussians, cameras, regions)
    else:
        sums = gathered_sums(gaussians, cameras, regions, method.gather)
    embeddings = [regions.embeddings(level)[0] for level in regions.levels]
    field = method.make(sums, embeddings, SETTINGS)
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    view = raster.project(gaussians, cameras[0])
    found = field.relevancy(view, queries, canonical)
    assert found.shape == (3, 2, 30, 40)
    assert found.min() >= 0
    assert found.max() <= 1
    slow = replace(field, quick=None).relevancy(view, queries, canonical)
    assert torch.allclose(found, slow, atol=1e-5)
    own = field.gaussian_relevancy(queries, canonical)
    coded = field.coded()
    assert own.shape == (3, 2, 60)
    assert coded.any()
    for level in range(3):
        assert (own[level][:, ~coded[level]] == 0.5).all()
    assert field.bytes_per_gaussian > 0
    assert method.follows
    assert method.departs


def test_sizes() -> None:
    gaussians, cameras, regions = small_scene(count=60, views=3)
    sums = region_sums(gaussians, cameras, regions)
    embeddings = [regions.embeddings(level)[0] for level in regions.levels]
    sizes = {
        name: METHODS[name].make(sums, embeddings, SETTINGS).bytes_per_gaussian
        for name in ("sparse", "sparse-64-all", "dense", "top-contributors", "autoencoder")
    }
    # 3 levels; 4 atoms of 3 bytes; 64 coefficients of 2; 16 floats; 16 bytes (D = 16); 3 floats.
    assert sizes == {
        "sparse": 36, "sparse-64-all": 384, "dense": 192, "top-contributors": 48, "autoencoder": 36,
    }  # fmt: skip


def test_dense_is_dense_uplift_and_sparse_is_a_build() -> None:
    gaussians, cameras, regions = small_scene(count=60, views=3)
    sums = region_sums(gaussians, cameras, regions)
    embeddings = [regions.embeddings(level)[0] for level in regions.levels]
    dense = METHODS["dense"].make(sums, embeddings, SETTINGS)
    for level in range(3):
        assert torch.equal(dense.values[level], dense_features(sums, embeddings, level))
    sparse = METHODS["sparse"].make(sums, embeddings, SETTINGS)
    field = build(gaussians, cameras, regions, settings=SETTINGS.build)
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    expected = field.relevancy(cameras[0], queries, canonical)
    found = sparse.relevancy(raster.project(gaussians, cameras[0]), queries, canonical)
    assert torch.allclose(found, expected, atol=2e-3)


def test_the_autoencoder_decodes_what_was_rendered() -> None:
    gaussians, cameras, regions = small_scene(count=60, views=3)
    sums = region_sums(gaussians, cameras, regions)
    embeddings = [regions.embeddings(level)[0] for level in regions.levels]
    field = METHODS["autoencoder"].make(sums, embeddings, SETTINGS)
    network = fit_autoencoder(torch.cat(embeddings), SETTINGS.autoencoder, 0)
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(3, 16))
    view = raster.project(gaussians, cameras[0])
    image, _ = raster.render_channels(view, field.values[1])
    decoded = network.decode(image.view(-1, 3)).view(30, 40, 16)
    both = (decoded @ torch.cat([queries, canonical]).T).permute(2, 0, 1)
    expected = relevancy(both[None, :2], both[None, 2:])[0]
    assert torch.allclose(field.relevancy(view, queries, canonical)[1], expected, atol=1e-5)


def test_unknown_method_and_consensus() -> None:
    with pytest.raises(UnknownNameError, match="dense"):
        find_method("dens")
    gaussians, cameras, regions = small_scene(count=60, views=3)
    sums = region_sums(gaussians, cameras, regions)
    rows = [regions.embeddings(level)[0] for level in regions.levels]
    settings = MethodSettings(build=BuildSettings(consensus=True))
    with pytest.raises(InputError, match="consensus"):
        METHODS["sparse"].make(sums, rows, settings)
