"""How like two scenes are: cosines and faults of masks, by hand."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from benchmarks.likeness import COLUMNS, likeness

from scoup.scene.cameras import Camera
from scoup.scene.regions import RegionMap, Regions
from scoup_lab.data.labels import LabelledFrame


def test_likeness_of_two_views() -> None:
    """Two things: one with a region in both views, 60 degrees apart, one swallowed in one view."""
    cup, pot = torch.zeros(20, 20, dtype=torch.bool), torch.zeros(20, 20, dtype=torch.bool)
    cup[2:8, 2:8], pot[10:18, 10:18] = True, True
    both = cup.int() + 2 * pot.int() - 1
    swallowed = cup.int() - 1
    swallowed[6:, 9:] = 1
    turned = [0.5, 3**0.5 / 2, 0.0]
    maps = {
        "a": {"m": RegionMap(both, torch.tensor([[1.0, 0, 0], [0, 0, 1]]))},
        "b": {"m": RegionMap(swallowed, torch.tensor([turned, [0.0, 0, 1]]))},
    }
    frames = [
        (LabelledFrame(name, 20, 20, {"cup": cup, "pot": pot}, {}),
         Camera.from_c2w(name, torch.eye(4), torch.eye(3), 20, 20))
        for name in maps
    ]  # fmt: skip
    words = {"cup": np.array([1.0, 0, 0]), "pot": np.array([0.0, 1, 0])}
    found = likeness(Regions.from_maps(maps), frames, words)["m"]
    assert set(found) == set(COLUMNS)
    assert found["regions"] == 2
    assert found["within"] == pytest.approx(0.5)
    assert found["between"] == pytest.approx(0)
    assert found["own"] == pytest.approx((1 + 0.5 + 0) / 3)
    assert found["others"] == pytest.approx((0 + 3**0.5 / 2 + 0) / 3)
    assert (found["swallowed"], found["split"], found["missing"]) == (0.25, 0, 0)
