"""Canonical phrases and everyday words."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, LEAST_WORDS, with_everyday
from support import unit


def test_canonical_phrases_are_the_papers() -> None:
    assert CANONICAL_PHRASES == ("object", "things", "stuff", "texture")


def random(*shape: int, seed: int = 0) -> Tensor:
    return unit(torch.randn(*shape, generator=torch.Generator().manual_seed(seed)))


def test_everyday_words() -> None:
    assert len(set(EVERYDAY_WORDS)) == len(EVERYDAY_WORDS) >= 100
    assert not set(EVERYDAY_WORDS) & set(CANONICAL_PHRASES)
    canonical, words = random(4, 16), random(LEAST_WORDS, 16, seed=1)
    both = with_everyday(canonical, words)
    assert torch.equal(both[:4], canonical)
    assert torch.allclose(both[4], words.mean(0))
    assert with_everyday(canonical, words[1:]) is canonical
