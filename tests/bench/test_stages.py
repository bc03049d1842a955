"""Stages run and give what their functions give, on every backend."""

from __future__ import annotations

import pytest
import torch

from messages import refuses
from scoup import raster
from scoup.base import InputError, UnknownNameError
from scoup_lab.bench.stages import STAGES, random_workload, stage_runs, usable_backends

BACKENDS = usable_backends()[0]


@pytest.fixture(scope="module")
def work():
    return random_workload(300, 40, 30, regions=(6, 4, 2))


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


def test_stages_and_backends_are_those_wanted(work, monkeypatch: pytest.MonkeyPatch):
    assert list(stage_runs(work, "reference", ["vote", "project"])) == ["vote", "project"]
    with refuses():
        stage_runs(work, "reference", ["paint"])
    monkeypatch.setitem(raster.BACKENDS, "broken", "scoup.raster.no_such_module")
    found, reasons = usable_backends()
    assert "reference" in found
    assert "broken" not in found
    assert "no_such_module" in reasons["broken"]
    for name, kind in (("broken", InputError), ("nonsense", UnknownNameError)):
        with refuses(kind):
            usable_backends([name])
    assert usable_backends(["reference", "reference"]) == (["reference"], {})
