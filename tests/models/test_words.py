"""Canonical phrases and everyday words."""

from __future__ import annotations

import torch
from torch import Tensor

from children import finished
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, LEAST_WORDS, with_everyday
from support import unit


def test_canonical_phrases_are_the_papers() -> None:
    assert CANONICAL_PHRASES == ("object", "things", "stuff", "texture")


def test_the_list_is_read_when_it_is_needed(preloaded_python: str) -> None:
    program = (
        "import scoup.models.text, scoup.models.words as words; assert 'EVERYDAY_WORDS' not in vars(words); "
        "assert words.EVERYDAY_WORDS is words.EVERYDAY_WORDS; assert not hasattr(words, 'OTHER_WORDS')"
    )
    finished([preloaded_python, "-c", program], check=True)


def random(*shape: int, seed: int = 0) -> Tensor:
    return unit(torch.randn(*shape, generator=torch.Generator().manual_seed(seed)))


def test_everyday_words() -> None:
    assert 950 <= len({word.casefold() for word in EVERYDAY_WORDS}) == len(EVERYDAY_WORDS) <= 1100
    assert not set(EVERYDAY_WORDS) & set(CANONICAL_PHRASES)
    for word in EVERYDAY_WORDS:
        assert word == " ".join(word.split())
        assert 1 <= len(word.split()) <= 2, word
    canonical, words = random(4, 16), random(LEAST_WORDS, 16, seed=1)
    both = with_everyday(canonical, words)
    assert torch.equal(both[:4], canonical)
    assert torch.allclose(both[4], words.mean(0))
    assert with_everyday(canonical, words[1:]) is canonical
