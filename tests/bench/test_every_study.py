"""Every study, tiny, from its options to a record that its table can be made of."""

from __future__ import annotations

import json
from itertools import product
from typing import Any

import pytest
import torch
from benchmarks.answer_presence import auc, presence_of_group
from benchmarks.compare import Compare
from benchmarks.lerf_sized import LerfSized
from benchmarks.query import STAGES, Query
from benchmarks.stages import Stages
from benchmarks.study import Record, Study, run
from benchmarks.things import PAIRS, Things

from scoup import raster
from scoup_lab.bench import usable_backends

SMALL: dict[str, Any] = {"width": 30, "height": 20}


def ran(study: Study) -> Record:
    """The record of a study, as JSON has it; its table can be made."""
    found = run(study, "test")
    assert json.loads(json.dumps(found)) == found
    return found


@pytest.mark.parametrize("backend", usable_backends()[0])
def test_a_whole_build(backend: str) -> None:
    found = ran(LerfSized(n_gaussians=80, views=3, regions=(6, 4, 2), preset="paper", epochs=3, n_atoms=8,
                          backend=backend, threads=1, **SMALL))  # fmt: skip
    assert {"coding s", "coding m", "coding l", "region sums", "after vote"} <= set(found["seconds"])
    assert sum(found["seconds"].values()) == pytest.approx(found["total_s"], abs=0.1)
    assert found["coded_gaussians"] > 0


@pytest.mark.usefixtures("quick_python")
def test_what_it_costs_to_ask() -> None:
    least = ran(Query(n_gaussians=200, n_atoms=8, repeats=2, verb_repeats=1, **SMALL))["least"]
    assert set(least) == set(STAGES)
    assert least["query, new camera"] > least["project"]


def test_stages_are_compared_with_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    backends = dict.fromkeys(("other", "reference"), raster.BACKENDS["reference"])
    monkeypatch.setattr(raster, "BACKENDS", {**backends, "broken": "scoup.none"})
    before, stages = torch.get_num_threads(), ("project", "sums")
    found = ran(Stages(n_gaussians=(60, 120), repeats=1, threads=(1, 2), stages=stages, **SMALL))
    assert torch.get_num_threads() == before
    median = {
        (count, row["stage"], row["backend"], row["threads"]): row["median_s"]
        for count, rows in found["rows"].items()
        for row in rows
    }
    assert set(median) == set(product(("60", "120"), stages, backends, (1, 2)))
    head, _, first, *lines, reason = Stages.table(found).splitlines()
    assert "threads: 2" in head
    assert len(lines) == 2 * len(stages) - 1
    ratio = median["60", "project", "reference", 1] / median["60", "project", "other", 1]
    assert [cell.strip() for cell in first.split("|")[1:6:2]] == ["60", "other", f"{ratio:.1f} x"]
    assert reason == "backend broken does not work here: No module named 'scoup.none'"


def test_stages_of_the_reference_alone() -> None:
    found = ran(
        Stages(n_gaussians=(60,), repeats=1, threads=(1,), backends=("reference",), stages=("vote",), **SMALL)
    )
    assert [row["backend"] for row in found["rows"]["60"]] == ["reference"]
    assert "| reference |" in Stages.table(found)


@pytest.mark.slow
def test_things_and_relations() -> None:
    (row,) = ran(Things(scenes=("table-0",), n_gaussians=6000, most=2, desk=False))["rows"]
    assert 0 < row["iou"] <= 1
    assert row["ap"]["0.25"] >= row["ap"]["0.5"] >= row["ap"]["0.75"]
    assert row["objects"] > 20
    assert set(row["relations"]) == {*PAIRS, "between"}
    hits, missed = (sum(of[place] for of in row["relations"].values()) for place in (0, 1))
    assert hits > 3 * missed  # so small a scene loses some
    assert sum(row["relations"]["left of"]) == 4  # two true ones, two false
    assert row["bytes"][0] > row["bytes"][1] == 6  # three levels, two bytes each


@pytest.mark.slow
def test_changes_between_captures() -> None:
    rows = ran(Compare(scenes=("yard-0",), n_gaussians=12_000, real=()))["rows"]["yard-0"]
    assert all(right <= reported for of in rows.values() for right, reported, _ in of.values())
    assert sum(right for right, _, _ in rows["changed"].values()) >= 4
    assert sum(reported for _, reported, _ in rows["unchanged"].values()) <= 1


def test_the_area_under_the_curve_counts_ties_half() -> None:
    tensor = torch.tensor([1.0, 2.0]).numpy()
    assert auc(tensor, tensor) == 0.5
    assert auc(tensor + 1, tensor) == 0.875


def test_presence_by_thresholds_chosen_on_the_other_scenes() -> None:
    one = {"present": [0.9, 0.8], "absent": [0.1, 0.5]}
    other = {"present": [0.45] * 4, "absent": [0.3]}
    found = presence_of_group({"desk": one, "table-real": other, "table-real-all": other})
    assert found["thresholds"] == {"desk": 0.45, "table-real": 0.805, "table-real-all": 0.805}
    assert found["chosen elsewhere"] == [pytest.approx(1 / 3, abs=1e-4), pytest.approx(2.5 / 3, abs=1e-4)]
    assert found["from"]["0.35"] == [1.0, pytest.approx(2.5 / 3, abs=1e-4)]
