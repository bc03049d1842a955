"""Regions of a view that a codebook was not learned from."""

from __future__ import annotations

import torch

from scoup.uplift.new_views import append_atoms, code_view, explained_thresholds
from support import unit

LEVELS = ("s", "m")


def test_append_atoms_fills_empty_places_first() -> None:
    codebook = torch.arange(1.0, 13).view(2, 2, 3)
    once = append_atoms(codebook, [torch.ones(2, 3), torch.ones(0, 3)])
    assert once.shape == (2, 4, 3)
    assert once[:, :2].equal(codebook)
    assert once[0, 2:].equal(torch.ones(2, 3))
    assert not once[1, 2:].any()
    twice = append_atoms(once, [torch.ones(0, 3), 2 * torch.ones(3, 3)])
    assert twice.shape == (2, 5, 3)
    assert twice[0].equal(torch.cat([once[0], torch.zeros(1, 3)]))
    assert twice[1].equal(torch.cat([codebook[1], 2 * torch.ones(3, 3)]))
    assert append_atoms(once, [torch.ones(0, 3)] * 2).equal(once)
    assert append_atoms(torch.zeros(1, 2, 3), [torch.ones(1, 3)])[0, :, 0].tolist() == [1.0, 0.0]


def test_view_coded_level_by_level() -> None:
    codebook = torch.eye(5)[None, :2].repeat(2, 1, 1)
    embeddings = [
        torch.tensor([[3.0, 1, 0, 0, 0], [0, 0, 0, 2, 0], [0, 0, 0, 0, 1], [0, 0, 0, 0, 0]]),
        torch.zeros(0, 5),
    ]
    plain = code_view(codebook, embeddings, 2, [0.5, 0.5])
    assert (plain.n_regions, plain.n_badly_explained, plain.n_new) == (3, 2, [0, 0])
    assert plain.codebook is codebook
    more = code_view(codebook, embeddings, 2, [0.5, 0.5], new_atoms=8)
    assert (more.n_new, more.n_badly_explained) == ([2, 0], 2)
    assert more.codebook.shape == (2, 4, 5)
    decoded = unit(more.codes[0].to_dense() @ more.codebook[0])
    torch.testing.assert_close(decoded, unit(embeddings[0]))
    assert [len(codes) for codes in more.codes] == [4, 0]
    assert code_view(codebook, embeddings, 2, None).n_badly_explained is None


def test_expected_cosines_of_a_field_that_does_not_tell() -> None:
    assert explained_thresholds({}, LEVELS) is None
    assert explained_thresholds({"coding": {"s": {}, "m": 3}}, LEVELS) is None
    told = {"coding": {"s": {"explained_from": 0.5}, "m": {"explained_from": 0.25}}}
    assert explained_thresholds(told, LEVELS) == [0.5, 0.25]
