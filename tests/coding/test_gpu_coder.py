"""Embeddings on a GPU."""

from __future__ import annotations

import pytest
import torch
from coders import clip_like

import scoup

if not torch.cuda.is_available():
    pytest.skip("needs a CUDA device", allow_module_level=True)


def test_embeddings_on_a_gpu_get_the_codes_of_a_cpu() -> None:
    rows = clip_like(3000, 128, objects=100)
    here, there = (scoup.fit_codes(part, 64) for part in (rows, rows.cuda()))
    assert there.atoms.is_cuda
    for ours, theirs in ((there.atoms, here.atoms), (there.codes.indices, here.codes.indices)):
        assert ours.cpu().equal(theirs)
    again = there.encode(rows.cuda()).codes
    assert again.weights.is_cuda
    assert again.weights.cpu().equal(here.encode(rows).codes.weights)
