"""Dataclasses of tensors in one line."""

from __future__ import annotations

import torch

import scoup
from scoup.query import TextVectors
from scoup.query.votes import Selection


def test_tensors_are_said_by_type_and_shape() -> None:
    codes = scoup.SparseCodes(torch.zeros(5, 2, dtype=torch.uint8), torch.zeros(5, 2), 8)
    assert repr(codes) == "SparseCodes(indices=uint8 [5, 2], weights=float32 [5, 2], n_atoms=8)"
    selection = Selection(torch.zeros(9, dtype=torch.bool), torch.zeros(9), 1, 0.25)
    assert repr(selection) == "Selection(mask=bool [9], relevancy=float32 [9], level=1, threshold=0.25)"
    names = tuple(f"a thing with a long name {number}" for number in range(100))
    texts = TextVectors(names, torch.zeros(100, 4), torch.zeros(4, 4), torch.zeros(9, 4))
    assert "queries=float32 [100, 4]" in repr(texts)
    assert len(repr(texts)) < 300
