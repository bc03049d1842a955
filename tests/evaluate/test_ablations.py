"""Parts of ablations and curves: halves by entropy, displaced masks, thinned pixels, subsets of views."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from scoup.base.errors import UnknownNameError
from scoup.baselines.methods import METHODS
from scoup.evaluate.published import ABLATIONS as PUBLISHED
from scoup.evaluate.studies.ablation_recipes import ABLATIONS, BASE, find_ablations
from scoup.evaluate.studies.ablations import _rule, _start, _without
from scoup.evaluate.studies.curves import FAULTS, displaced_masks, find_fault
from scoup.evaluate.studies.rasterised import every_nth_pixel, of_views
from scoup.query.presence import vote_entropy
from scoup.query.presets import QUERY_PRESETS
from scoup.uplift.rasterise import region_sums
from scoup.uplift.vote import GaussianCodes
from support import small_scene, unit


def test_halves_by_entropy() -> None:
    votes = torch.rand(41, 3, 8, generator=torch.Generator().manual_seed(0)) ** 4
    votes[5:9, 1] = 0  # without votes
    entropy = vote_entropy(votes)
    whole = GaussianCodes(torch.zeros(41, 3, 8, dtype=torch.uint8), votes)
    calm, torn = (_without(whole, whole, half).weights for half in ("highest", "lowest"))
    for level in range(3):
        kept, dropped = calm[:, level].any(1), torn[:, level].any(1)
        voted = votes[:, level].any(1)
        assert torch.equal(kept | dropped, voted)
        assert not (kept & dropped).any()
        assert abs(int(kept.sum()) - int(dropped.sum())) <= 1
        assert entropy[kept, level].max() <= entropy[dropped, level].min()
        assert torch.equal(calm[kept, level], votes[kept, level])


def test_starts() -> None:
    rows = unit(torch.randn(30, 6))
    assert _start(rows, 4, "k-means", 0) is None
    drawn = _start(rows, 4, "random regions", 0)
    assert drawn is not None
    assert all((rows == atom).all(1).any() for atom in drawn)
    free = _start(rows, 4, "random directions", 0)
    assert free is not None
    assert torch.allclose(free.norm(dim=1), torch.ones(4))
    assert not any((rows == atom).all(1).any() for atom in free)


def test_rules_of_rows() -> None:
    preset = QUERY_PRESETS["scoup"]
    rules = {each.name: _rule(each, preset) for each in ABLATIONS}
    assert [name for name, rule in rules.items() if rule.everyday] == ["beside everyday words"]
    assert rules["level by mask"].preset.level_choice == "mask"
    assert rules["only level m"].levels == ("m",)
    assert rules["beside everyday words"].preset == preset


def test_rows_are_complete() -> None:
    names = [each.name for each in ABLATIONS]
    assert len(set(names)) == len(names)
    assert {each.published for each in ABLATIONS} - {""} == set(PUBLISHED)
    sizes = {(each.recipe.n_atoms, each.recipe.k) for each in ABLATIONS}
    assert {(32, 4), (64, 4), (128, 4), (64, 2), (64, 8)} <= sizes
    chosen = find_ablations(["atoms"])
    assert chosen[0].name == ABLATIONS[0].name
    assert {each.group for each in chosen[1:]} == {"atoms"}
    assert find_ablations([]) == list(ABLATIONS)
    assert ABLATIONS[0].recipe == BASE
    with pytest.raises(UnknownNameError, match="atoms"):
        find_ablations(["atom"])
    with pytest.raises(UnknownNameError, match="noise"):
        find_fault("nois")
    assert all(fault.strengths for fault in FAULTS.values())


def test_displaced_masks() -> None:
    _, _, regions = small_scene(views=2, width=60, height=40)
    moved, again = displaced_masks(regions, 8.0, 1), displaced_masks(regions, 8.0, 1)
    name = regions.view_names[0]
    first, second = regions.load(name, "m"), moved.load(name, "m")
    assert torch.equal(second.labels, again.load(name, "m").labels)
    changed = (first.labels != second.labels).float().mean()
    assert 0.02 < changed < 0.6
    assert torch.equal(first.embeddings, second.embeddings)
    assert torch.equal(displaced_masks(regions, 0.0).load(name, "m").labels, first.labels)
    other = displaced_masks(regions, 8.0, 2).load(name, "m").labels
    assert not torch.equal(other, second.labels)
    less = displaced_masks(regions, 3.0, 1).load(name, "m").labels
    assert (first.labels != less).float().mean() < changed


def test_every_nth_pixel_counts_a_share() -> None:
    gaussians, cameras, regions = small_scene(count=60, views=2)
    whole = region_sums(gaussians, cameras, regions)
    thinned = region_sums(gaussians, cameras, every_nth_pixel(regions, 2))
    labels = every_nth_pixel(regions, 2).load(regions.view_names[0], "m").labels
    assert (labels[::2] == -1).all()
    assert (labels[:, ::2] == -1).all()
    assert torch.equal(labels[1::2, 1::2], regions.load(regions.view_names[0], "m").labels[1::2, 1::2])
    share = thinned.matrix(0).sum() / whole.matrix(0).sum()
    assert 0.2 < share < 0.3


def test_subsets_of_views_keep_their_order() -> None:
    _, _, regions = small_scene(views=4)
    names = regions.view_names
    assert of_views(regions, [names[2], names[0]]).view_names == (names[0], names[2])


def test_methods_share_seeds_and_regions() -> None:
    """Names and texts that tables and documents rely on."""
    assert next(iter(METHODS)) == "sparse"
    assert {method.system for method in METHODS.values()} >= {
        "LUDVIG",
        "Occam's LGS",
        "VALA",
        "Dr. Splat",
        "LangSplat",
    }
    assert np.all([method.follows and method.departs for method in METHODS.values()])
