"""Presence: standing by hand, what an answer is made of, in views and in scenes."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError
from scoup.field.language_field import LanguageField
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, LEAST_WORDS, with_everyday
from scoup.query.answers import QUERY_PRESETS, segment, select, select_with_level
from scoup.query.presence import (
    answer_core,
    mean_embedding,
    scene_standing,
    standing,
    view_standing,
    vote_entropy,
)
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from support import small_scene, unit


def random(*shape: int, seed: int = 0) -> Tensor:
    return unit(torch.randn(*shape, generator=torch.Generator().manual_seed(seed)))


def test_entropy_of_votes() -> None:
    weights = torch.tensor(
        [[[1.0, 0, 0, 0]], [[0.25, 0.25, 0.25, 0.25]], [[0, 0, 0, 0.0]], [[2.0, 2.0, 0, 0]]]
    )
    assert vote_entropy(weights)[:, 0].tolist() == pytest.approx([0, 1, 1, 0.5])
    assert vote_entropy(weights * 7)[:, 0].tolist() == pytest.approx([0, 1, 1, 0.5])


def test_standing_by_hand() -> None:
    answers, queries, words = random(3, 16), random(3, 16, seed=1), random(20, 16, seed=2)
    cosines = (answers @ words.T).double().numpy()
    own = (answers * queries).sum(1).double().numpy()
    expected = (own - cosines.mean(1)) / cosines.std(1)
    assert standing(answers, queries, words).numpy() == pytest.approx(expected, abs=1e-5)
    # The length of an answer says nothing.
    assert standing(answers * 37, queries, words).numpy() == pytest.approx(expected, abs=1e-5)
    # A word that is the query itself is no word to compare it with.
    own_among_them = standing(answers, queries, torch.cat([words, queries[:1]]))
    assert float(own_among_them[0]) == pytest.approx(expected[0], abs=1e-5)
    assert float(own_among_them[1]) != pytest.approx(expected[1], abs=1e-5)


def test_what_was_asked_for_stands_high_and_nothing_stands_nowhere() -> None:
    queries, words = random(2, 64), random(50, 64, seed=2)
    found = standing(torch.stack([queries[0], torch.zeros(64)]), queries, words)
    assert float(found[0]) > 5
    assert float(found[1]) == -np.inf


def test_what_does_not_fit_is_refused() -> None:
    queries, words = random(2, 16), random(LEAST_WORDS, 16, seed=2)
    with pytest.raises(InputError, match="everyday words or more"):
        standing(queries, queries, words[1:])
    with pytest.raises(InputError, match="do not fit"):
        standing(queries[:1], queries, words)
    with pytest.raises(InputError, match="do not fit"):
        standing(queries, queries, words[:, 1:])


def test_everyday_words() -> None:
    assert len(set(EVERYDAY_WORDS)) == len(EVERYDAY_WORDS) >= 100
    assert not set(EVERYDAY_WORDS) & set(CANONICAL_PHRASES)
    canonical, words = random(4, 16), random(LEAST_WORDS, 16, seed=1)
    both = with_everyday(canonical, words)
    assert torch.equal(both[:4], canonical)
    assert torch.allclose(both[4], words.mean(0))
    assert with_everyday(canonical, words[1:]) is canonical


def test_the_core_is_the_more_relevant_half_of_the_mask() -> None:
    maps = torch.full((2, 24, 30), 0.4)
    maps[1, 4:14, 6:20] = torch.linspace(0.7, 0.9, 14)
    level, core = answer_core(maps)
    mask = segment(maps).mask
    assert level == 1
    assert bool((core & ~mask).any()) is False
    assert 0.4 < int(core.sum()) / int(mask.sum()) < 0.7
    columns = core.nonzero()[:, 1].float()
    assert columns.mean() > mask.nonzero()[:, 1].float().mean()


def test_an_empty_mask_gives_the_peak() -> None:
    level, core = answer_core(torch.full((3, 9, 9), 0.5))
    assert (level, int(core.sum())) == (0, 81)


def asked() -> tuple[LanguageField, raster.Projection, Tensor, Tensor, Tensor, Tensor]:
    gaussians, cameras, regions = small_scene(count=80, views=3)
    field = build(gaussians, cameras, regions, BuildSettings(n_atoms=8))
    view = field.project(cameras[0])
    queries, canonical, words = random(11, 16), random(3, 16, seed=1), random(30, 16, seed=2)
    return field, view, field.relevancy(cameras[0], queries, canonical, view), queries, canonical, words


def test_standing_in_a_view_against_pixel_by_pixel() -> None:
    """The answer's embedding is that of the pixels of the core, each a sum of decoded codes by blending weights."""
    field, view, maps, queries, _, words = asked()
    found = view_standing(field, view, maps, queries, words)
    blended = raster.render_channels(view, torch.eye(len(field)))[0]  # [H, W, N]
    for query in range(len(queries)):
        level, core = answer_core(maps[:, query], QUERY_PRESETS["default"])
        painted = blended[core].sum(0)
        dense = torch.zeros(len(field), field.n_atoms)
        dense.scatter_add_(1, field.code_indices[:, level].long(), field.code_weights[:, level].float())
        answer = (painted @ dense) @ field.codebook[level]
        expected = standing(answer[None], queries[query : query + 1], words)
        assert float(found[query]) == pytest.approx(float(expected[0]), abs=1e-3)


def test_standing_in_a_scene_is_of_the_gaussians_selected() -> None:
    field, _, _, queries, canonical, words = asked()
    selections = list(select_with_level(field, queries, canonical))
    assert torch.equal(
        torch.stack([chosen for chosen, _, _ in selections]), select(field, queries, canonical)
    )
    found = scene_standing(field, selections, queries, words)
    for query, (chosen, relevancy, level) in enumerate(selections):
        own = field.gaussian_relevancy(queries[query : query + 1], canonical)[level, 0]
        assert torch.equal(relevancy, own)
        middle = own[chosen].median()
        core = torch.tensor([row for row in range(len(field)) if chosen[row] and own[row] >= middle])
        answer = mean_embedding(field, level, core, field.gaussians.opacities[core])
        expected = standing(answer[None], queries[query : query + 1], words)
        assert float(found[query]) == pytest.approx(float(expected[0]), abs=1e-4)
    nothing = [(torch.zeros_like(chosen), relevancy, level) for chosen, relevancy, level in selections]
    assert bool((scene_standing(field, nothing, queries, words) == -torch.inf).all())
