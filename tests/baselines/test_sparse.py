"""Sparse codes as a method: halves of the Gaussians by the entropy of their votes."""

from __future__ import annotations

import pytest
import torch

from scoup.uplift import GaussianCodes
from scoup_lab.baselines.sparse import vote_entropy, without_half


def test_entropy_of_votes() -> None:
    weights = torch.tensor(
        [[[1.0, 0, 0, 0]], [[0.25, 0.25, 0.25, 0.25]], [[0, 0, 0, 0.0]], [[2.0, 2.0, 0, 0]]]
    )
    assert vote_entropy(weights)[:, 0].tolist() == pytest.approx([0, 1, 1, 0.5])
    assert vote_entropy(weights * 7)[:, 0].tolist() == pytest.approx([0, 1, 1, 0.5])


def test_halves_by_entropy() -> None:
    votes = torch.rand(41, 3, 8, generator=torch.Generator().manual_seed(0)) ** 4
    votes[5:9, 1] = 0  # without votes
    entropy = vote_entropy(votes)
    whole = GaussianCodes(torch.zeros(41, 3, 8, dtype=torch.uint8), votes)
    calm, torn = (without_half(whole, whole, half).weights for half in ("highest", "lowest"))
    for level in range(3):
        kept, dropped = calm[:, level].any(1), torn[:, level].any(1)
        voted = votes[:, level].any(1)
        assert torch.equal(kept | dropped, voted)
        assert not (kept & dropped).any()
        assert abs(int(kept.sum()) - int(dropped.sum())) <= 1
        assert entropy[kept, level].max() <= entropy[dropped, level].min()
        assert torch.equal(calm[kept, level], votes[kept, level])
