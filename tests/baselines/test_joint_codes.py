"""Codes learned through renderings: loss and gradients against dense autograd, and what the codes must be."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor

from messages import refuses
from scoup import raster
from scoup.scene import RegionMap, Regions
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.joint_codes import (
    JointCodes,
    JointSettings,
    ViewTargets,
    fit_joint_codes,
    rendering_loss,
    top_codes,
)
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import RasterisedScene, UpliftInputs
from scoup_lab.baselines.trained import learn_joint_codes
from scoup_lab.baselines.view_weights import weights_of_views
from support import small_scene, unit

SMALL = JointSettings(iterations=60, n_atoms=8, k=3, learning_rate=0.05, width=20)


def learned(scene: RasterisedScene, settings: JointSettings = SMALL, seed: int = 0) -> JointCodes:
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
            targets = ViewTargets(pixels, labels[pixels], embeddings)
            loss = rendering_loss(view, logits[view.members], atoms, targets, k)
            found = torch.autograd.grad(loss, (logits, atoms), allow_unused=True)
            dense = dense_loss(scene, number, level, logits, atoms, k, 20)
            expected = torch.autograd.grad(dense, (logits, atoms), allow_unused=True)
            assert loss.item() == pytest.approx(dense.item(), abs=1e-5)
            for mine, theirs in zip(found, expected, strict=True):
                assert mine is not None
                assert theirs is not None
                assert torch.allclose(mine, theirs, atol=2e-6)
            if k > 1:
                assert found[0].abs().max() > 1e-5  # one atom alone has weight 1 whatever its logit
            assert found[1].abs().max() > 1e-5


def test_kept_codes() -> None:
    logits = torch.tensor([[0.0, 2.0, 1.0, -1.0], [0.0, 0.0, 0.0, 0.0]])
    indices, weights = top_codes(logits, 2)
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


def test_what_is_learned_shows_the_regions(scene: RasterisedScene) -> None:
    """The loss at the end is that of the codes and codebook that are handed out."""
    settings = replace(SMALL, iterations=200, width=40)
    found = learned(scene, settings)
    blurred = learned(scene, replace(settings, iterations=0))
    for level, name in enumerate(scene.regions.levels):
        cosines = []
        for each in (found, blurred):
            codes = torch.zeros(80, 8).scatter(1, each.indices[:, level].long(), each.weights[:, level])
            camera = scene.cameras[0]
            projection = raster.project(scene.gaussians, camera)
            image, _ = raster.render_channels(projection, codes @ each.codebook[level])
            region = scene.regions.load(camera.name, name)
            there = region.labels >= 0
            shown = region.embeddings[region.labels[there].long()]
            cosines.append(float(torch.nn.functional.cosine_similarity(image[there], shown).mean()))
        assert cosines[0] > cosines[1] + 0.1


def test_a_seed_gives_the_same_codes_and_another_one_others(scene: RasterisedScene) -> None:
    first, again, other = (learned(scene, replace(SMALL, iterations=8), seed) for seed in (3, 3, 4))
    assert torch.equal(first.indices, again.indices)
    assert torch.equal(first.weights, again.weights)
    assert torch.equal(first.codebook, again.codebook)
    assert first.losses == again.losses
    assert first.losses != other.losses


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
    means = gaussians.means.clone()
    means[7] = torch.tensor([0.0, 0.0, -50.0])  # behind every camera
    moved = replace(gaussians, means=means)
    found = learned(RasterisedScene(moved, cameras, regions))
    assert not found.weights[7].any()
    assert found.weights.any(-1).sum() > 60

    def without_coarse(view: str, level: str) -> RegionMap:
        region = regions.load(view, level)
        if level != "l" or view == regions.view_names[0]:
            return region
        return RegionMap(torch.full_like(region.labels, -1), region.embeddings)

    half = Regions(regions.levels, regions.view_names, without_coarse)
    sparse = learned(RasterisedScene(moved, cameras, half)).weights.any(-1)
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


def test_a_share_of_the_views(scene: RasterisedScene) -> None:
    """Only these views are rendered, with the rows of their own regions."""
    method = replace(METHODS["joint-codes"], views=0.4)
    inputs = scene.inputs(views=0.4)
    assert inputs.scene is not None
    assert inputs.scene.regions.view_names == (scene.regions.view_names[1],)
    alone = RasterisedScene(scene.gaussians, scene.cameras, inputs.scene.regions)
    few, expected = (
        each.fit(of, MethodSettings(joint=SMALL))
        for each, of in ((method, scene), (METHODS["joint-codes"], alone))
    )
    assert isinstance(few, FittedField)
    assert isinstance(expected, FittedField)
    assert torch.equal(few.field.code_weights, expected.field.code_weights)
    assert torch.equal(few.field.codebook, expected.field.codebook)


def test_what_cannot_be_learned_is_refused(scene: RasterisedScene) -> None:
    inputs = scene.inputs()
    with refuses():
        learn_joint_codes(UpliftInputs(inputs.sums, inputs.embeddings), MethodSettings(joint=SMALL))
    for settings in (replace(SMALL, iterations=-1), SMALL):
        with refuses():
            fit_joint_codes([], [unit(torch.randn(3, 4))], [{}], 5, settings)
