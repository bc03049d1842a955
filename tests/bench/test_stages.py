"""Stages run and give what their functions give, on every backend; the bound of the arithmetic."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from raster.brute_force import blending_weights
from scoup import raster
from scoup.base.errors import InputError, UnknownNameError
from scoup.bench import bound
from scoup.bench.stages import STAGES, make_workload, room_workload, stage_runs, usable_backends
from scoup.synthetic.room import make_room, room_cameras

BACKENDS = usable_backends()[0]


@pytest.fixture(scope="module")
def work():
    return room_workload(300, 40, 30, regions=(6, 4, 2))


@pytest.mark.parametrize("backend", BACKENDS)
def test_every_stage_runs(work, backend):
    runs = stage_runs(work, backend)
    assert list(runs) == list(STAGES)
    results = {name: run() for name, run in runs.items()}
    assert results["project"].backend == backend
    image, alpha = results["alpha"]
    assert image.shape == (30, 40, 1)
    assert torch.allclose(image[..., 0], alpha, atol=1e-5)
    sums = results["sums"]
    assert len(sums.gaussian) == len(sums.combination) == len(sums.weight) > 0
    assert int(sums.combination.max()) < len(sums.table)
    # Every pixel has a region, so what is summed up is what is painted.
    assert float(sums.weight.sum()) == pytest.approx(float(alpha.sum()), rel=1e-3)
    assert sums.table.shape[1] == 3
    assert results["colors"][0].shape == (30, 40, 3)
    assert results["codes"].shape == (3, 30, 40, 64)
    assert results["cosines"].shape == (3, 1, 30, 40)
    assert results["vote"].indices.shape == results["vote"].weights.shape == (300, 3, 4)


@pytest.mark.parametrize("backend", BACKENDS)
def test_the_vote_is_over_what_is_painted(work, backend):
    runs = stage_runs(work, backend, ["sums", "vote"])
    painting = runs["sums"]().gaussian.unique().long()
    weights = runs["vote"]().weights
    painted = torch.zeros(300, dtype=torch.bool)
    painted[painting] = True  # every pixel has a region at every level
    expected = painted[:, None].expand(300, 3).float()
    torch.testing.assert_close(weights.sum(2), expected)


def test_stages_in_the_order_wanted(work):
    assert list(stage_runs(work, "reference", ["vote", "project"])) == ["vote", "project"]
    with pytest.raises(InputError, match="no stage 'paint'; stages: project, alpha"):
        stage_runs(work, "reference", ["paint"])


def test_a_workload_of_any_scene():
    room, camera = make_room(100), room_cameras(1, 20, 10)[0]
    labels = torch.full((2, 10, 20), -1, dtype=torch.int32)
    work = make_workload("own", room, camera, labels, n_atoms=8, k=2, dim=16, n_queries=3).to("cpu")
    assert (work.name, work.codebook.shape, work.queries.shape) == ("own", (2, 8, 16), (3, 16))
    assert stage_runs(work, "reference", ["cosines"])["cosines"]().shape == (2, 3, 10, 20)


def test_backends_that_do_not_work_are_named(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(raster.BACKENDS, "broken", "scoup.raster.no_such_module")
    found, reasons = usable_backends()
    assert "reference" in found
    assert "broken" not in found
    assert "no_such_module" in reasons["broken"]
    with pytest.raises(InputError, match="backend 'broken' does not work here"):
        usable_backends(["broken"])
    with pytest.raises(UnknownNameError):
        usable_backends(["nonsense"])
    assert usable_backends(["reference", "reference"]) == (["reference"], {})


@pytest.mark.parametrize(("width", "height"), [(40, 30), (32, 32), (17, 5)])
def test_evaluations_are_counted_inside_the_image(width, height):
    room, camera = make_room(60), room_cameras(1, width, height)[0]
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
