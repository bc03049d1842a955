"""Faults of curves."""

from __future__ import annotations

import pytest
import torch

from scoup.base.errors import UnknownNameError
from scoup_lab.evaluate.studies.curves import FAULT_SCALES, displaced_masks, find_fault
from support import small_scene


def test_faults_by_name() -> None:
    with pytest.raises(UnknownNameError, match="noise"):
        find_fault("nois")
    assert all(fault.strengths for fault in FAULT_SCALES.values())


def test_displaced_masks() -> None:
    _, _, regions = small_scene(views=2, width=60, height=40)
    moved, again = displaced_masks(regions, 8.0, 1), displaced_masks(regions, 8.0, 1)
    name = regions.view_names[0]
    first, second = regions.load(name, "m"), moved.load(name, "m")
    assert torch.equal(second.labels, again.load(name, "m").labels)
    changed = (first.labels != second.labels).float().mean()
    assert 0.02 < changed < 0.6
    assert torch.equal(first.embeddings, second.embeddings)
    assert torch.equal(displaced_masks(regions, 0.0).load(name, "m").labels, first.labels)
    other = displaced_masks(regions, 8.0, 2).load(name, "m").labels
    assert not torch.equal(other, second.labels)
    less = displaced_masks(regions, 3.0, 1).load(name, "m").labels
    assert (first.labels != less).float().mean() < changed
