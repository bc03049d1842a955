"""The bound of the arithmetic: what counts as an evaluation, and the clock of a core."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from benchmarks import bound

from raster.brute_force import blending_weights
from scoup.base.errors import InputError
from scoup_lab.synthetic.random_scene import random_scene_cameras, random_scene_gaussians


@pytest.mark.parametrize(("width", "height"), [(40, 30), (32, 32), (17, 5)])
def test_evaluations_are_counted_inside_the_image(width, height):
    room, camera = random_scene_gaussians(60), random_scene_cameras(1, width, height)[0]
    truth = blending_weights(room, camera, "inria")
    counted = bound.count_evaluations(room, camera)
    assert abs(counted - int((truth.weights > 0).sum())) <= int(np.sum(truth.unsure)) * len(room)
    assert counted == pytest.approx(int((truth.weights > 0).sum()), rel=0.01)


def test_the_bound():
    assert bound.arithmetic_bound(16_000_000, 2e9, 1) == pytest.approx(0.0055)
    assert bound.arithmetic_bound(16_000_000, 2e9, 2) == pytest.approx(0.00275)
    assert bound.clock_hz(2.6) == bound.Clock(2.6e9, "option")
    with pytest.raises(InputError, match="positive"):
        bound.clock_hz(0)


def test_the_clock_comes_from_the_core_if_it_can_tell(monkeypatch: pytest.MonkeyPatch):
    class Core:
        @staticmethod
        def measure_clock_hz() -> float:
            return 3.1e9

    monkeypatch.setattr(bound, "native_core", lambda: Core)
    assert bound.clock_hz() == bound.Clock(3.1e9, "native core")


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc/cpuinfo")
def test_the_clock_the_system_tells(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(bound, "native_core", lambda: None)
    monkeypatch.setattr(Path, "read_text", lambda *_: "cpu MHz\t\t: 2600.000\ncpu MHz : 2400.5\n")
    assert bound.clock_hz() == bound.Clock(2.6e9, "cpuinfo")
    monkeypatch.setattr(Path, "read_text", lambda *_: "nothing told\n")
    assert bound.clock_hz() is None
