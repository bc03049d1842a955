"""Phrases that every query is compared with: the canonical phrases of the papers, and everyday words.

CLIP gives some places a high cosine with any word. The canonical phrases of the protocols are four words of one kind.
The mean of many words of all kinds is a better estimate of what all words share (docs/evaluation.md, "Everyday words").
"""

from __future__ import annotations

import torch
from torch import Tensor

CANONICAL_PHRASES = ("object", "things", "stuff", "texture")
"""Every query is compared with these (method.md, stage 3). They are encoded without a prompt template."""

EVERYDAY_WORDS = (
    "person", "child", "hand", "face", "dog", "cat", "bird", "horse", "cow", "elephant", "fish", "insect",
    "tree", "grass", "flower", "leaf", "rock", "sand", "water", "sky", "snow", "fire",
    "house", "road", "bridge", "fence", "stairs", "wall", "floor", "ceiling", "window", "door",
    "car", "bicycle", "bus", "train", "boat", "airplane",
    "table", "chair", "sofa", "bed", "cupboard", "shelf", "lamp", "mirror", "curtain", "carpet", "pillow",
    "plate", "cup", "bottle", "knife", "spoon", "pot", "kettle", "oven", "refrigerator", "sink",
    "bread", "apple", "banana", "cheese", "meat", "soup", "cake", "coffee",
    "book", "paper", "pen", "scissors", "clock", "telephone", "computer", "keyboard", "television", "camera",
    "shirt", "shoe", "hat", "bag", "umbrella", "glasses", "ring",
    "ball", "toy", "doll", "guitar", "piano", "drum", "hammer", "rope", "bucket", "box", "candle",
    "towel", "toothbrush", "toilet", "bathtub", "wheel",
)  # fmt: skip
"""About a hundred names of things, outdoors and indoors, for text models; a word table has words of its own."""
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
