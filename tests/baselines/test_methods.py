"""Methods: each is fitted to one scene of random regions and gives relevancy, also at other sizes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

from scoup import raster
from scoup.field import relevancy
from scoup.scene import SparseCodes
from scoup.uplift import BuildSettings, build, build_settings
from scoup_lab.baselines.autoencoder import AutoencoderSettings, fit_autoencoder
from scoup_lab.baselines.fitted import FittedChannels, FittedField, code_cosines, resized_image
from scoup_lab.baselines.joint_codes import JointSettings
from scoup_lab.baselines.method import Method, MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from scoup_lab.baselines.trained import QuantisedUplift
from support import small_scene, unit

SETTINGS = MethodSettings(
    build=BuildSettings(n_atoms=8, effort="fast", epochs=5),
    autoencoder=AutoencoderSettings(epochs=2, encoder=(8, 3), decoder=(8,)),
    joint=JointSettings(iterations=3, n_atoms=8, width=20),
)


@pytest.fixture(scope="module")
def scene() -> RasterisedScene:
    return RasterisedScene(*small_scene(count=60, views=3))


def texts() -> tuple[Tensor, Tensor]:
    """Queries [2, 16] and canonical phrases [3, 16]."""
    return unit(torch.randn(2, 16)), unit(torch.randn(3, 16))


@pytest.mark.parametrize("name", list(METHODS))
def test_every_method_gives_relevancy(scene: RasterisedScene, name: str) -> None:
    method = METHODS[name]
    fitted = method.fit(scene, SETTINGS)
    queries, canonical = texts()
    projection = raster.project(scene.gaussians, scene.cameras[0])
    found = fitted.relevancy(projection, queries, canonical)
    assert found.shape == (3, 2, 30, 40)
    assert found.min() >= 0
    assert found.max() <= 1
    own = fitted.gaussian_relevancy(queries, canonical)
    coded = fitted.coded()
    assert own.shape == (3, 2, 60)
    assert coded.any()
    for level in range(3):
        assert (own[level][:, ~coded[level]] == 0.5).all()
    assert fitted.bytes_per_gaussian == SIZES.get(name, fitted.bytes_per_gaussian) > 0
    assert method.follows
    assert method.departs


def test_codes_give_what_their_channels_give(scene: RasterisedScene) -> None:
    """The same codes as channels: the same relevancy, rendered at any size and of the Gaussians themselves."""
    fitted = METHODS["sparse"].fit(scene, SETTINGS)
    assert isinstance(fitted, FittedField)
    field = fitted.field
    codes = zip(field.code_indices.unbind(1), field.code_weights.float().unbind(1), strict=True)
    dense = [SparseCodes(indices, weights, 8).to_dense() for indices, weights in codes]
    channels = FittedChannels(dense, [code_cosines(atoms) for atoms in field.codebook], 36.0)
    queries, canonical = texts()
    projection = raster.project(scene.gaussians, scene.cameras[0])
    for size in (None, (40, 30), (25, 19)):
        found, expected = (
            each.relevancy(projection, queries, canonical, size) for each in (fitted, channels)
        )
        assert torch.allclose(found, expected, atol=1e-5)
    own, expected = (each.gaussian_relevancy(queries, canonical) for each in (fitted, channels))
    assert torch.allclose(own, expected, atol=1e-5)
    assert fitted.coded().equal(channels.coded())


# 3 levels; 4 atoms of 3 bytes and a thing of 2; 64 coefficients of 2; 16 floats; 16 bytes
# (D = 16); 3 floats.
SIZES = {"sparse": 42, "sparse-64-all": 384, "dense": 192, "top-45-contributors": 48,
         "autoencoder": 36}  # fmt: skip


@pytest.mark.parametrize(("name", "given", "expected"), [
    ("sparse", SETTINGS.build, SETTINGS.build),
    ("paper", BuildSettings(epochs=3), build_settings("paper", epochs=3)),
])  # fmt: skip
def test_fields_are_builds(
    scene: RasterisedScene, name: str, given: BuildSettings, expected: BuildSettings
) -> None:
    fitted = METHODS[name].fit(scene, replace(SETTINGS, build=given))
    assert isinstance(fitted, FittedField)
    field = build(scene.gaussians, scene.cameras, scene.regions, settings=expected)
    for part in ("code_indices", "code_weights", "codebook"):
        assert torch.equal(getattr(fitted.field, part), getattr(field, part)), part


def test_relevancy_of_dense_uplift_is_that_of_the_rendered_features(scene: RasterisedScene) -> None:
    fitted = METHODS["dense"].fit(scene)
    assert isinstance(fitted, FittedChannels)
    projection, (queries, canonical) = raster.project(scene.gaussians, scene.cameras[0]), texts()
    found = fitted.relevancy(projection, queries, canonical)
    for level, features in enumerate(fitted.channels):
        image = unit(raster.render_channels(projection, features)[0])
        both = (image @ torch.cat([queries, canonical]).T).permute(2, 0, 1)[None]
        assert torch.allclose(found[level], relevancy(both[:, :2], both[:, 2:])[0], atol=1e-6)


def test_the_autoencoder_decodes_what_was_rendered(scene: RasterisedScene) -> None:
    """And the three numbers of a Gaussian are the mean of those of its regions, row by row, through the network's
    layers: codes in another order, or of other rows, are not these."""
    fitted, inputs = METHODS["autoencoder"].fit(scene, SETTINGS), scene.inputs()
    assert isinstance(fitted, FittedChannels)
    network = fit_autoencoder(torch.cat(list(inputs.embeddings)), SETTINGS.autoencoder, 0)
    for level, embeddings in enumerate(inputs.embeddings):
        with torch.no_grad():
            codes = torch.stack([unit(network.encoder(row[None]))[0] for row in embeddings])
        expected = torch.from_numpy(inputs.sums.matrix(level).toarray()) @ codes
        assert torch.allclose(fitted.channels[level], unit(expected), atol=1e-4)
    queries, canonical = texts()
    projection = raster.project(scene.gaussians, scene.cameras[0])
    image, _ = raster.render_channels(projection, fitted.channels[1])
    decoded = network.decode(image.view(-1, 3)).view(30, 40, 16)
    both = (decoded @ torch.cat([queries, canonical]).T).permute(2, 0, 1)
    expected = relevancy(both[None, :2], both[None, 2:])[0]
    assert torch.allclose(fitted.relevancy(projection, queries, canonical)[1], expected, atol=1e-5)


def test_parts_of_a_quantised_feature(scene: RasterisedScene) -> None:
    for parts, size in ((4, 4), (7, 4), (64, 16)):  # the largest divisor of 16 that is not more
        assert Method("", QuantisedUplift(parts)).fit(scene, SETTINGS).bytes_per_gaussian == 3 * size


def test_the_table_of_methods_names_each_once() -> None:
    text = (Path(__file__).parents[2] / "docs" / "evaluation.md").read_text()
    section = text.split("## Methods compared")[1].split("\n## ")[0]
    named = [line.split("`")[1] for line in section.splitlines() if line.startswith("| `")]
    assert sorted(named) == sorted(METHODS)


def test_resizing_is_bilinear_by_pixel_centres() -> None:
    image = torch.rand(5, 6, 2, generator=torch.Generator().manual_seed(0))
    assert resized_image(image, 6, 5) is image
    found = resized_image(image, 9, 4)
    for y in range(4):
        for x in range(9):
            v, u = max((y + 0.5) * 5 / 4 - 0.5, 0), max((x + 0.5) * 6 / 9 - 0.5, 0)
            v0, u0 = int(v), int(u)
            v1, u1 = min(v0 + 1, 4), min(u0 + 1, 5)
            a, b = v - v0, u - u0
            expected = (1 - a) * ((1 - b) * image[v0, u0] + b * image[v0, u1])
            expected += a * ((1 - b) * image[v1, u0] + b * image[v1, u1])
            assert torch.allclose(found[y, x], expected, atol=1e-6)


def test_features_are_resized_before_they_are_compared(scene: RasterisedScene) -> None:
    """Of a language field: coefficients are resized, which is the same as resizing features."""
    field = build(scene.gaussians, scene.cameras, scene.regions, settings=SETTINGS.build)
    fitted, camera = FittedField(field), scene.cameras[0]
    projection, (queries, canonical) = field.project(camera), texts()
    found = fitted.relevancy(projection, queries, canonical, (25, 19))
    assert found.shape == (3, 2, 19, 25)
    codes = field.render_codes(camera)
    for level in range(3):
        features = unit(resized_image(codes[level] @ field.codebook[level], 25, 19))
        cosines = (features @ torch.cat([queries, canonical]).T).permute(2, 0, 1)
        expected = relevancy(cosines[None, :2], cosines[None, 2:])[0]
        assert torch.allclose(found[level], expected, atol=1e-5)
    same = fitted.relevancy(projection, queries, canonical, (40, 30))
    assert same.equal(field.relevancy(camera, queries, canonical))
