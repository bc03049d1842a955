"""Phrases that every query is compared with: the canonical phrases of the papers, and everyday words.

CLIP gives some places a high cosine with any word. The canonical phrases of the protocols are four words of one kind.
The mean of many words of all kinds is a better estimate of what all words share (docs/method.md, stage 3).
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

CANONICAL_PHRASES = ("object", "things", "stuff", "texture")
"""Every query is compared with these (method.md, stage 3). They are encoded without a prompt template."""

EVERYDAY_WORDS = tuple(
    Path(__file__).with_name("everyday_words.txt").read_text(encoding="utf-8").splitlines()
)
"""About a thousand names of things, indoors and outdoors, for text models; a word table has words of its own."""
LEAST_WORDS = 16
"""Fewer words say nothing about words in general: with eight, absent things were often reported as present."""


def with_everyday(canonical: Tensor, words: Tensor) -> Tensor:
    """Append the mean of everyday words [B, D] to the canonical phrases [P, D], as the preset "default" does.

    The mean is not scaled to unit norm. Its cosine with an embedding is then the mean of the words' cosines, about
    that of any single word. Fewer words than ``LEAST_WORDS`` change nothing.
    """
    if len(words) < LEAST_WORDS:
        return canonical
    return torch.cat([canonical, words.to(canonical).mean(0, keepdim=True)])
