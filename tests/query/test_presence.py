"""Presence: z-scores by hand, in views and in scenes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from query.conftest import Queried, random_vectors
from scoup import raster
from scoup.base.errors import InputError
from scoup.models.words import LEAST_WORDS
from scoup.query.presence import (
    PRESENT_FROM,
    mean_embedding,
    other_words,
    scene_z_scores,
    view_z_scores,
    with_evidence,
    z_scores,
)
from scoup.query.segment import segment
from scoup.query.select import select_each


def test_z_scores_by_hand() -> None:
    embeddings, queries, words = (
        random_vectors(3, 16),
        random_vectors(3, 16, seed=1),
        random_vectors(20, 16, seed=2),
    )
    cosines = np.sort((embeddings @ words.T).double().numpy(), 1)
    own = (embeddings * queries).sum(1).double().numpy()
    expected = 1.645 + (own - cosines[:, 18]) / cosines.std(1)  # 19 of 20 are 95 %
    assert z_scores(embeddings, queries, words).numpy() == pytest.approx(expected, abs=1e-5)
    # The length of an embedding says nothing.
    assert z_scores(embeddings * 37, queries, words).numpy() == pytest.approx(expected, abs=1e-5)
    # A word that is the query itself is no word to compare it with.
    own_among_them = z_scores(embeddings, queries, torch.cat([words, queries[:1]]))
    assert float(own_among_them[0]) == pytest.approx(expected[0], abs=1e-5)
    assert float(own_among_them[1]) != pytest.approx(expected[1], abs=1e-5)


def test_words_that_fit_better_take_what_was_found() -> None:
    """Words at right angles: what was found is mostly two kinds of pot, and a little a toilet."""
    words = torch.eye(24)
    found = (0.9 * (words[0] + words[1]) + 0.5 * words[2])[None]
    lone = z_scores(found, words[2:3], words[3:])
    beside = z_scores(found, words[2:3], words)
    assert float(z_scores(found, words[:1], words)) > PRESENT_FROM  # nothing fits better
    # By the lag behind the second pot, in deviations of the 23 cosines: the toilet is no word to compare itself with.
    length = np.sqrt(2 * 0.81 + 0.25)
    lag = (0.5 - 0.9) / length / (np.array([0.9, 0.9, *[0.0] * 21]) / length).std()
    assert float(beside) == pytest.approx(1.645 + lag, abs=1e-4)
    assert float(beside) < PRESENT_FROM < float(lone)


def test_fewer_than_ten_gaussians_are_no_evidence() -> None:
    assert with_evidence(2.0, torch.arange(30) < 10) == 2.0
    assert with_evidence(2.0, torch.arange(30) < 9) == -np.inf


def test_large_tables_judge_as_small_ones_do() -> None:
    """The best of many words is better than the best of few; words in general are not."""
    queries, found = random_vectors(40, 16, seed=1), random_vectors(40, 16)
    found = torch.nn.functional.normalize(found + queries, dim=1)
    words = random_vectors(3000, 16, seed=2)
    many, few = z_scores(found, queries, words), z_scores(found, queries, words[::20])
    assert float((many - few).mean().abs()) < 0.15


def test_other_names_of_a_query_are_no_words_to_compare_it_with() -> None:
    query, words = random_vectors(1, 64), random_vectors(200, 64, seed=2)
    names = torch.nn.functional.normalize(query + 0.3 * random_vectors(15, 64, seed=3) / 2, dim=1)
    table = torch.cat([words, names])
    assert other_words(query, table)[0].tolist() == [True] * 200 + [False] * 15
    found = torch.nn.functional.normalize(query + 0.1 * words[:1], dim=1)
    assert float(z_scores(found, query, table)) == pytest.approx(
        float(z_scores(found, query, words)), abs=1e-4
    )


def test_the_query_itself_scores_high_and_nothing_scores_minus_infinity() -> None:
    queries, words = random_vectors(2, 64), random_vectors(50, 64, seed=2)
    found = z_scores(torch.stack([queries[0], torch.zeros(64)]), queries, words)
    assert float(found[0]) > 5
    assert float(found[1]) == -np.inf


def test_what_does_not_fit_is_refused() -> None:
    queries, words = random_vectors(2, 16), random_vectors(LEAST_WORDS, 16, seed=2)
    with pytest.raises(InputError, match="everyday words or more"):
        z_scores(queries, queries, words[1:])
    with pytest.raises(InputError, match="do not fit"):
        z_scores(queries[:1], queries, words)
    with pytest.raises(InputError, match="do not fit"):
        z_scores(queries, queries, words[:, 1:])


def test_z_scores_in_a_view_against_pixel_by_pixel(queried: Queried) -> None:
    """The embedding is that of the pixels of the core, each a sum of decoded codes by blending weights."""
    field, texts = queried.field, queried.texts
    queries, words = texts.queries, texts.everyday
    projection = field.project(queried.camera)
    maps = field.relevancy(queried.camera, queries, texts.canonical, projection)
    segmentations = [segment(each) for each in maps.unbind(1)]
    found = view_z_scores(field, projection, segmentations, queries, words)
    blended = raster.render_channels(projection, torch.eye(len(field)))[0]  # [H, W, N]
    for query in range(len(queries)):
        level = segmentations[query].level
        painted = blended[segmentations[query].core()].sum(0)
        dense = torch.zeros(len(field), field.n_atoms)
        dense.scatter_add_(1, field.code_indices[:, level].long(), field.code_weights[:, level].float())
        embedding = (painted @ dense) @ field.codebook[level]
        expected = z_scores(embedding[None], queries[query : query + 1], words)
        assert float(found[query]) == pytest.approx(float(expected[0]), abs=1e-3)


def test_z_scores_in_a_scene_are_of_the_gaussians_selected(queried: Queried) -> None:
    field, texts = queried.field, queried.texts
    queries, canonical, words = texts.queries, texts.canonical, texts.everyday
    selections = list(select_each(field, queries, canonical))
    found = scene_z_scores(field, selections, queries, words)
    for query, each in enumerate(selections):
        chosen, level = each.mask, each.level
        own = field.gaussian_relevancy(queries[query : query + 1], canonical)[level, 0]
        assert torch.equal(each.relevancy, own)
        coded = field.code_weights[:, level].any(1)
        assert each.score == float(own[coded].max())
        middle = own[chosen].median()
        core = torch.tensor([row for row in range(len(field)) if chosen[row] and own[row] >= middle])
        embedding = mean_embedding(field, level, core, field.gaussians.opacities[core])
        expected = z_scores(embedding[None], queries[query : query + 1], words)
        assert float(found[query]) == pytest.approx(float(expected[0]), abs=1e-4)
    nothing = [replace(each, mask=torch.zeros_like(each.mask)) for each in selections]
    assert bool((scene_z_scores(field, nothing, queries, words) == -torch.inf).all())
