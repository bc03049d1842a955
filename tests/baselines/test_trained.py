"""What baselines learn: codes through renderings against dense autograd, autoencoders, product quantisers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from messages import refuses
from scoup import raster
from scoup.scene import RegionMap
from scoup_lab.baselines import joint_codes
from scoup_lab.baselines.autoencoder import (
    LANGSPLAT,
    AutoencoderSettings,
    fit_autoencoder,
    reconstruction_loss,
)
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.product_quantisation import fit_product_quantiser
from scoup_lab.baselines.rasterised_scene import RasterisedScene, UpliftInputs
from scoup_lab.baselines.trained import learn_joint_codes
from scoup_lab.baselines.view_weights import rendered, weights_of_views
from support import changed_regions, small_scene, unit

SMALL = joint_codes.JointSettings(iterations=60, n_atoms=8, k=3, learning_rate=0.05, width=20)


def learned(
    scene: RasterisedScene, settings: joint_codes.JointSettings = SMALL, seed: int = 0
) -> joint_codes.JointCodes:
    return learn_joint_codes(scene.inputs(), MethodSettings(seed, joint=settings))


@pytest.fixture(scope="module")
def scene() -> RasterisedScene:
    return RasterisedScene(*small_scene(count=80, views=3))


def dense_loss(
    scene: RasterisedScene, view: int, level: str, logits: Tensor, atoms: Tensor, k: int, width: int
) -> Tensor:
    """The loss as it is written down: a softmax over all logits of all Gaussians, the K largest scaled to sum 1, an
    image of features, the mean of 1 - cosine over the pixels with a region."""
    camera = scene.cameras[view].resized(width, width * 3 // 4)
    projection = raster.project(scene.gaussians, camera, backend="reference")
    blending, _ = raster.render_channels(projection, torch.eye(len(scene.gaussians)))  # [H, W, N]
    shares = logits.softmax(1)
    bound = shares.topk(k, dim=1).values[:, -1:]
    shares = torch.where(shares >= bound, shares, 0.0)
    features = blending @ (shares / shares.sum(1, keepdim=True)) @ atoms
    labels = scene.regions.load_labels(camera.name, camera.width, camera.height)
    labels = labels[scene.regions.levels.index(level)]
    there = labels >= 0
    expected = scene.regions.load(camera.name, level).embeddings[labels[there].long()]
    return (1 - torch.nn.functional.cosine_similarity(features[there], expected)).mean()


@pytest.mark.parametrize("k", [1, 3, 8])
def test_loss_and_gradients_against_dense_autograd(scene: RasterisedScene, k: int) -> None:
    random = torch.Generator().manual_seed(k)
    views = weights_of_views(scene, 20)
    for number, view in enumerate(views):
        for position, level in enumerate(scene.regions.levels):
            logits = torch.randn(80, 8, generator=random, requires_grad=True)
            atoms = torch.randn(8, 16, generator=random, requires_grad=True)
            labels = view.labels[position]
            pixels = (labels >= 0).nonzero()[:, 0]
            embeddings = scene.regions.load(view.name, level).embeddings
            targets = joint_codes.ViewTargets(pixels, labels[pixels], embeddings)
            loss = joint_codes.rendering_loss(view, logits[view.members], atoms, targets, k)
            found = torch.autograd.grad(loss, (logits, atoms), allow_unused=True)
            dense = dense_loss(scene, number, level, logits, atoms, k, 20)
            expected = torch.autograd.grad(dense, (logits, atoms), allow_unused=True)
            assert loss.item() == pytest.approx(dense.item(), abs=1e-5)
            for mine, theirs in zip(found, expected, strict=True):
                torch.testing.assert_close(mine, theirs, atol=2e-6, rtol=1e-5)
            if k > 1:
                assert found[0].abs().max() > 1e-5  # one atom alone has weight 1 whatever its logit
            assert found[1].abs().max() > 1e-5


def test_kept_codes() -> None:
    logits = torch.tensor([[0.0, 2.0, 1.0, -1.0], [0.0, 0.0, 0.0, 0.0]])
    indices, weights = joint_codes.top_codes(logits, 2)
    assert indices.tolist() == [[1, 2], [0, 1]]  # of equal ones the first
    first = 1 / (1 + torch.tensor(-1.0).exp())
    assert torch.allclose(weights, torch.tensor([[first, 1 - first], [0.5, 0.5]]))


def test_the_loss_falls_and_the_codes_are_codes(scene: RasterisedScene) -> None:
    found = learned(scene)
    assert [len(of_level) for of_level in found.losses] == [60, 60, 60]
    for of_level in found.losses:
        assert sum(of_level[-6:]) < 0.9 * sum(of_level[:6])
    assert found.indices.shape == found.weights.shape == (80, 3, 3)
    assert found.indices.dtype == torch.uint8
    assert found.codebook.shape == (3, 8, 16)
    assert int(found.indices.max()) < 8
    coded = found.weights.any(-1)
    assert coded.any()
    assert found.weights.min() >= 0
    assert torch.allclose(found.weights.sum(-1)[coded], torch.ones(int(coded.sum())), atol=1e-5)
    assert (found.weights.diff(dim=-1) <= 0).all()
    for row in found.indices[coded].tolist():
        assert len(set(row)) == 3
    once, again, other = (learned(scene, replace(SMALL, iterations=6), seed) for seed in (0, 0, 4))
    for part in ("indices", "weights", "codebook"):
        assert torch.equal(getattr(once, part), getattr(again, part))
    assert once.losses == again.losses != other.losses


def test_what_is_learned_shows_the_regions(scene: RasterisedScene) -> None:
    """The loss at the end is that of the codes and codebook that are handed out."""
    settings = replace(SMALL, iterations=200, width=40)
    found = learned(scene, settings)
    blurred = learned(scene, replace(settings, iterations=0))
    for level, name in enumerate(scene.regions.levels):
        cosines = []
        region = scene.regions.load(scene.cameras[0].name, name)
        there = region.labels >= 0
        shown = region.embeddings[region.labels[there].long()]
        for each in (found, blurred):
            codes = torch.zeros(80, 8).scatter(1, each.indices[:, level].long(), each.weights[:, level])
            projection = raster.project(scene.gaussians, scene.cameras[0])
            image, _ = raster.render_channels(projection, codes @ each.codebook[level])
            cosines.append(float(torch.nn.functional.cosine_similarity(image[there], shown).mean()))
        assert cosines[0] > cosines[1] + 0.1


def test_every_view_has_its_turn(scene: RasterisedScene) -> None:
    """In rounds: three steps show three views. Without steps of any size the losses of a round come again."""
    # All atoms are kept: of equal logits, the smallest step changes which.
    tiny = replace(SMALL, n_atoms=3, iterations=6, learning_rate=1e-12)
    for of_level in learned(scene, tiny).losses:
        first, second = sorted(of_level[:3]), sorted(of_level[3:])
        assert first == pytest.approx(second, abs=1e-6)
        assert first[0] < first[1] < first[2]


def test_gaussians_that_paint_no_region_have_no_code() -> None:
    gaussians, cameras, regions = small_scene(count=60, views=2)
    gaussians.means[7] = torch.tensor([0.0, 0.0, -50.0])  # behind every camera
    found = learned(RasterisedScene(gaussians, cameras, regions))
    assert not found.weights[7].any()
    assert found.weights.any(-1).sum() > 60

    def without_coarse(view: str, level: str, region: RegionMap) -> RegionMap:
        if level != "l" or view == regions.view_names[0]:
            return region
        return RegionMap(torch.full_like(region.labels, -1), region.embeddings)

    half = changed_regions(regions, without_coarse)
    sparse = learned(RasterisedScene(gaussians, cameras, half)).weights.any(-1)
    whole = found.weights.any(-1)
    assert torch.equal(sparse[:, :2], whole[:, :2])
    assert sparse[:, 2].sum() < whole[:, 2].sum()


def test_the_method_is_these_codes(scene: RasterisedScene) -> None:
    seen: list[tuple[str, int, int]] = []
    settings = MethodSettings(1, joint=replace(SMALL, iterations=2), progress=lambda *call: seen.append(call))
    found = learn_joint_codes(scene.inputs(), settings)
    assert seen == [("joint codes", done, 6) for done in range(7)]
    fitted = METHODS["joint-codes"].fit(scene, settings)
    assert isinstance(fitted, FittedField)
    assert torch.equal(fitted.field.code_indices, found.indices)
    assert torch.equal(fitted.field.code_weights, found.weights.half())
    assert torch.equal(fitted.field.codebook, found.codebook)
    assert fitted.bytes_per_gaussian == 3 * 3 * 3  # levels, atoms, a byte and a half


def test_what_cannot_be_learned_is_refused(scene: RasterisedScene) -> None:
    inputs = scene.inputs()
    with refuses():
        weights_of_views(scene, 0)
    with refuses():
        learn_joint_codes(UpliftInputs(inputs.sums, inputs.embeddings), MethodSettings(joint=SMALL))
    for settings in (replace(SMALL, iterations=-1), SMALL):
        with refuses():
            joint_codes.fit_joint_codes([], [unit(torch.randn(3, 4))], [{}], 5, settings)


@pytest.mark.parametrize("width", [20, 40, 400])
def test_products_with_the_weights_are_renderings(width: int) -> None:
    gaussians, cameras, regions = small_scene(80, views=2)
    views = weights_of_views(RasterisedScene(gaussians, cameras, regions), width)
    assert [view.name for view in views] == list(regions.view_names)
    channels = torch.randn(80, 5)
    for camera, view in zip(cameras, views, strict=True):
        small = camera.resized(20, 15) if width == 20 else camera  # never enlarged
        image, _ = raster.render_channels(raster.project(gaussians, small), channels)
        labels = regions.load_labels(camera.name, small.width, small.height).flatten(1).long()
        described = (labels >= 0).any(0)
        assert torch.equal(view.labels, labels[:, described])
        found = rendered(view, channels[view.members])
        assert torch.allclose(found, image.view(-1, 5)[described], atol=1e-5)
        assert (view.weights.sum(0) > 0).all()  # members are those that paint
        assert len(view.members) < 80
        assert torch.equal(view.members, view.members.unique())


NETWORK = AutoencoderSettings(epochs=12, batch=16, learning_rate=1e-2, encoder=(16, 3), decoder=(16,))


def clusters(count: int = 120, dim: int = 12, seed: int = 0) -> Tensor:
    """[count, dim] rows around four directions, of any norm."""
    generator = torch.Generator().manual_seed(seed)
    centres = torch.randn(4, dim, generator=generator)
    which = torch.randint(4, (count,), generator=generator)
    noise = torch.randn(count, dim, generator=generator)
    return (centres[which] + 0.1 * noise) * (0.5 + torch.rand(count, 1, generator=generator))


def test_training_brings_reconstructions_nearer() -> None:
    """And leaves the random state alone."""
    rows, means = clusters(), []
    before = torch.random.get_rng_state()
    for epochs in (0, 2, 12):
        fitted = fit_autoencoder(rows, replace(NETWORK, epochs=epochs))
        codes = fitted.encode(rows)
        decoded = fitted.decode(codes)
        assert codes.shape == (120, 3)
        assert not codes.requires_grad
        for each in (codes, decoded):
            assert torch.allclose(each.norm(dim=1), torch.ones(120))
        means.append(float(torch.nn.functional.cosine_similarity(decoded, rows, dim=1).mean()))
    assert means == sorted(means)
    assert means[-1] > 0.95
    first, same, other = (fit_autoencoder(rows, NETWORK, seed).encode(rows) for seed in (3, 3, 4))
    assert torch.equal(before, torch.random.get_rng_state())
    assert torch.equal(first, same)
    assert not torch.equal(first, other)


def test_the_layers_and_the_loss_are_those_of_langsplat() -> None:
    fitted = fit_autoencoder(torch.randn(3, 512), AutoencoderSettings(epochs=0))

    def sizes(part: nn.Sequential) -> list[int]:
        return [layer.out_features for layer in part if isinstance(layer, nn.Linear)]

    assert sizes(fitted.encoder) == [256, 128, 64, 32, 3]
    assert sizes(fitted.decoder) == [16, 32, 64, 128, 256, 256, 512]
    kinds = [[type(layer).__name__ for layer in part] for part in (fitted.encoder, fitted.decoder)]
    assert kinds == [["Linear", *["BatchNorm1d", "ReLU", "Linear"] * 4], ["Linear", *["ReLU", "Linear"] * 6]]
    assert (LANGSPLAT.epochs, LANGSPLAT.batch, LANGSPLAT.learning_rate) == (100, 64, 7e-4)
    found, rows = torch.tensor([[1.0, 0.0], [0.0, 1.0]]), torch.tensor([[1.0, 0.0], [1.0, 0.0]])
    assert float(reconstruction_loss(found, rows)) == pytest.approx(2 / 4 + 1e-3 * 0.5)


def test_rows_of_norm_zero_are_left_out() -> None:
    rows = clusters()
    with_zeros = torch.cat([torch.zeros(1, 12), rows, torch.zeros(2, 12)])
    plain, fitted = fit_autoencoder(rows, NETWORK), fit_autoencoder(with_zeros, NETWORK)
    codes = fitted.encode(with_zeros)
    assert torch.equal(codes[1:-2], plain.encode(rows))
    assert not codes[[0, -2, -1]].any()
    assert not fitted.decode(codes)[[0, -2, -1]].any()
    for nothing in (torch.zeros(0, 5), torch.zeros(4, 5)):
        codes = fit_autoencoder(nothing, NETWORK).encode(nothing)
        assert codes.shape == (len(nothing), 3)
        assert not codes.any()


@pytest.mark.parametrize("count", [1, 2, 15, 16, 17, 33])
def test_any_number_of_rows(count: int) -> None:
    seen: list[tuple[str, int, int]] = []
    rows = clusters(count)
    fitted = fit_autoencoder(rows, NETWORK, progress=lambda *call: seen.append(call))
    assert torch.isfinite(fitted.encode(rows)).all()
    steps = 12 * {33: 2}.get(count, 1)  # a row left over joins the batch before it
    assert seen == [("autoencoder", done, steps) for done in range(steps + 1)]


def test_bad_input_is_refused() -> None:
    for rows in (torch.zeros(3), torch.zeros(3, 4, dtype=torch.long), torch.tensor([[1.0, float("nan")]])):
        with refuses():
            fit_autoencoder(rows, NETWORK)
    with refuses():
        fit_autoencoder(torch.ones(3, 4), replace(NETWORK, epochs=-1))


def normal_rows(count: int, dim: int, seed: int = 0) -> torch.Tensor:
    return torch.randn(count, dim, generator=torch.Generator().manual_seed(seed))


def test_codes_are_the_nearest_centroids_of_each_part() -> None:
    data = normal_rows(600, 12)
    quantiser = fit_product_quantiser(data, 3)
    assert quantiser.centroids.shape == (3, 256, 4)
    codes = quantiser.encode(data[:50])
    assert codes.dtype == torch.uint8
    decoded = quantiser.decode(codes).numpy()
    for row, code, back in zip(data[:50].numpy(), codes.numpy(), decoded, strict=True):
        for part in range(3):
            distances = ((quantiser.centroids[part] - row[part * 4 : part * 4 + 4]) ** 2).sum(1)
            assert distances[code[part]] == pytest.approx(distances.min(), abs=1e-5)
        expected = np.concatenate([quantiser.centroids[part, code[part]] for part in range(3)])
        np.testing.assert_array_equal(back, expected)


def test_k_means_only_improves() -> None:
    data = normal_rows(900, 8)
    fitted = [fit_product_quantiser(data, 2, iterations=n) for n in (1, 4, 12)]
    losses = [float((each.decode(each.encode(data)) - data).square().sum(1).mean()) for each in fitted]
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < 0.9 * losses[0]
    first, again, other = (fit_product_quantiser(data, 4, seed).centroids for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_as_many_centroids_as_rows_lose_nothing() -> None:
    data = normal_rows(40, 6)
    quantiser = fit_product_quantiser(data, 2)
    assert torch.equal(quantiser.decode(quantiser.encode(data)), data)
    alike = torch.ones(5, 6)  # more centroids than different rows
    quantiser = fit_product_quantiser(alike, 3)
    assert torch.equal(quantiser.decode(quantiser.encode(alike)), alike)
    with refuses():
        fit_product_quantiser(normal_rows(0, 8), 2)
