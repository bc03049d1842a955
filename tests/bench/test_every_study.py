"""Every study, tiny, from its options to a record that its table can be made of, and its figures by hand."""

from __future__ import annotations

import inspect
import json
import sys
from itertools import product
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from benchmarks import gpu
from benchmarks.answer_presence import auc, presence_of_group
from benchmarks.compare import Compare
from benchmarks.first_words import LONGEST, FirstWords
from benchmarks.gpu import Gpu
from benchmarks.gpu_rows import QUERIES, answers_row
from benchmarks.lerf_sized import LerfSized
from benchmarks.query import STAGES, Query
from benchmarks.registration import FOUND, KNOWN, RIGHT, SIMULATED, Registration
from benchmarks.stages import Stages
from benchmarks.study import Record, Study, run
from benchmarks.things import RELATIONS, Things, average_precision
from benchmarks.things_truth import is_true

from messages import refuses
from scoup import raster
from scoup.coding.exact import EFFORTS, ExactSettings
from scoup_lab.bench import random_workload, usable_backends

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


@pytest.mark.skipif(sys.platform == "win32", reason="terminals of POSIX")
@pytest.mark.usefixtures("quick_python")
def test_first_words_are_those_on_a_terminal() -> None:
    verbs = ("info demo/demo.scoup", "query demo/demo.scoup teapot")
    times = ran(FirstWords(n_gaussians=2000, repeats=1, verbs=verbs))["rows"]
    assert list(times) == ["info", "query"]
    assert all(0 < time < LONGEST for of_verb in times.values() for time in of_verb)


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
    alone = Stages(
        n_gaussians=(60,), repeats=1, threads=(1,), backends=("reference",), stages=("vote",), **SMALL
    )
    assert "| reference |" in Stages.table(ran(alone))


@pytest.mark.slow
def test_things_and_relations() -> None:
    (row,) = ran(Things(scenes=("table-0",), n_gaussians=6000, most=2, desk=False))["rows"]
    assert 0 < row["iou"] <= 1
    assert 1 >= row["ap"]["0.25"] >= row["ap"]["0.5"] > 0
    assert row["objects"] > 20
    assert set(row["relations"]) == {*RELATIONS}
    hits, missed = (sum(of[place] for of in row["relations"].values()) for place in (0, 1))
    assert hits > 3 * missed  # so small a scene loses some
    assert sum(row["relations"]["left of"]) == 4  # two true ones, two false


@pytest.mark.slow
def test_changes_between_captures() -> None:
    rows = ran(Compare(scenes=("yard-0",), n_gaussians=12_000, real=()))["rows"]["yard-0"]
    assert all(right <= reported for of in rows.values() for right, reported, _ in of.values())
    assert sum(right for right, _, _ in rows["changed"].values()) >= 4
    assert sum(reported for _, reported, _ in rows["unchanged"].values()) <= 1


@pytest.mark.slow
@pytest.mark.timeout(300)  # four scenes
def test_frames_of_captures() -> None:
    rows = ran(Registration(scenes=("yard-0", "table-0"), n_gaussians=12_000, real=()))["rows"]
    for name in ("yard-0", "table-0"):
        assert rows[name]["error"] <= RIGHT
        assert {kind: right[0] for kind, right in rows[name][FOUND].items()} == {
            kind: right[0] for kind, right in rows[name][KNOWN].items()
        }
    assert rows[f"different places, {SIMULATED}"] == {"pairs": 2, "accepted": []}


def test_the_area_under_the_curve_counts_ties_half() -> None:
    scores = np.array([1.0, 2.0])
    assert (auc(scores, scores), auc(scores + 1, scores)) == (0.5, 0.875)


def test_presence_by_thresholds_chosen_on_the_other_scenes() -> None:
    one = {"present": [0.9, 0.8], "absent": [0.1, 0.5]}
    other = {"present": [0.45] * 4, "absent": [0.3]}
    found = presence_of_group({"desk": one, "table-real": other, "table-real-all": other})
    assert found["thresholds"] == {"desk": 0.45, "table-real": 0.805, "table-real-all": 0.805}
    assert found["chosen elsewhere"] == [pytest.approx(1 / 3, abs=1e-4), pytest.approx(2.5 / 3, abs=1e-4)]
    assert found["from"]["0.35"] == [1.0, pytest.approx(2.5 / 3, abs=1e-4)]


SPANS = {  # along right, up and away
    "table": [(0, 2), (0.7, 0.75), (0, 1)],
    "mug": [(0.2, 0.3), (0.75, 0.85), (0.4, 0.5)],
    "bowl": [(1.4, 1.8), (0.75, 0.9), (0.6, 0.9)],
    "lamp": [(0.9, 1.1), (1.8, 2), (0.4, 0.6)],
}
BOXES = {name: np.array(spans) for name, spans in SPANS.items()}


@pytest.mark.parametrize(
    ("one", "relation", "other", "truth"),
    [
        ("mug", "left of", "bowl", True), ("bowl", "left of", "mug", False), ("mug", "left of", "table", None),
        ("mug", "in front of", "bowl", True), ("lamp", "in front of", "mug", False),
        ("mug", "in front of", "lamp", None),
        ("mug", "on", "table", True), ("lamp", "on", "table", False), ("mug", "on", "bowl", False),
        ("lamp", "above", "table", True), ("table", "above", "lamp", False),
    ],
)  # fmt: skip
def test_relations_of_boxes(one, relation, other, truth) -> None:
    assert is_true(relation, BOXES[one], BOXES[other]) is truth


def test_average_precision_by_hand() -> None:
    overlaps = np.array([[0.9, 0.0], [0.8, 0.1], [0.0, 0.6], [0.0, 0.0]])  # the second finds the first again
    assert average_precision(overlaps, 0.5) == pytest.approx((1 + 2 / 3) / 2)
    assert average_precision(overlaps, 0.7) == pytest.approx(0.5)
    assert average_precision(np.zeros((0, 2)), 0.5) == 0


@pytest.mark.slow
@pytest.mark.usefixtures("quick_python")
def test_times_of_archives() -> None:
    pytest.importorskip("duckdb", reason="duckdb is not installed (pip install 'scoup[archive]')")
    from benchmarks.archive_times import ArchiveTimes

    (row,) = ran(ArchiveTimes(things=(150,), scans=("table-0",), size=(3000, 96, 72, 6, 0)))["rows"].values()
    assert row["things"] >= 150
    assert row["scans"] >= 2
    assert all(wall > 0 for wall, _ in row["seconds"].values())


TINY = Gpu(n_gaussians=60, width=30, height=20, large=(32, 24), n_atoms=(8,), views=3, repeats=1)


def stand_in(work: Any) -> Any:
    """gsplat's module: it renders with the reference."""
    projection = raster.project(work.gaussians, work.camera, "gsplat", "reference")

    def rasterization(colors: torch.Tensor, **_: object) -> tuple[torch.Tensor]:
        return (raster.render_channels(projection, colors)[0][None],)

    return SimpleNamespace(rasterization=rasterization)


@pytest.fixture
def _on_a_cpu(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Gpu, "device", "cpu")
    monkeypatch.setattr(Gpu, "backend", "reference")
    monkeypatch.setattr(gpu, "LEAST_SECONDS", 0.0)
    monkeypatch.setattr(gpu, "answers_row", lambda device: {"device": device})  # tested below
    for effort in EFFORTS:  # what codes are best does not matter here
        monkeypatch.setitem(EFFORTS, effort, ExactSettings(steps=5, passes=1))


@pytest.mark.filterwarnings("ignore:the near plane")  # random Gaussians lie in front of it
@pytest.mark.usefixtures("_on_a_cpu")
def test_every_row_is_timed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", stand_in(random_workload(60, 30, 20)))
    rows = run(TINY, "gpu")["rows"]
    assert rows.pop(gpu.DIFFERENCE)["value"] < 1e-6
    assert rows.pop("answers of a scene, by the command line") == {"device": "cpu"}
    build = rows.pop("build")
    assert build["seconds"] >= build["stages"]["region sums"] > 0
    for size in ("30 x 20", "32 x 24"):
        parity = rows.pop(f"parity, {size}")
        assert [len(set(parity["region sums"]["entries"])), parity["vote"]["other codes"]] == [1, 0]
        names = ("RGB", "coefficient maps", "cosines", "relevancy")
        assert all(parity[name]["mean"] < 1e-6 for name in names)
    assert len(rows) == 5 + 3 + 5 + len(QUERIES)
    assert all(row["median_s"] > 0 for row in rows.values())
    assert "| gsplat: RGB " in capsys.readouterr().out


@pytest.mark.slow
def test_answers_of_two_fields_by_the_command_line() -> None:
    answers = answers_row("cpu", 2000, 40, 32, 3)
    assert answers["least IoU"] == 1
    assert answers["words"] == answers["same level"] > 1


@pytest.mark.usefixtures("_on_a_cpu")
def test_what_fails_is_a_row_with_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "gsplat", None)
    rows = dict(TINY.measure({}))
    assert rows[gpu.THEIRS]["reason"].startswith("ModuleNotFoundError")
    assert rows["RGB"]["median_s"] > 0
    left = dict(TINY.measure({name: of for name, of in rows.items() if name != "RGB"}))
    assert list(left) == ["RGB"]
    assert gpu.THEIRS in Gpu.table({"rows": rows})


@pytest.mark.usefixtures("_on_a_cpu")
def test_a_lost_device_ends_the_command_after_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = Mock(side_effect=RuntimeError("an illegal memory access was encountered"))
    rows = TINY.measure({})
    monkeypatch.setattr(raster, "render_cosines", lost)
    monkeypatch.setitem(sys.modules, "gsplat", stand_in(random_workload(60, 30, 20)))
    reason = "RuntimeError: an illegal memory access was encountered"
    assert next(rows) == ("relevancy of a query, L = 8", {"reason": reason})
    monkeypatch.setattr(torch, "zeros", lost)
    with refuses():
        next(rows)


def test_without_a_gpu_it_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with refuses():
        run(TINY, "gpu")


def test_gsplat_takes_our_arguments() -> None:
    module = pytest.importorskip("gsplat")
    given: dict[str, Any] = {}

    def rasterization(**arguments: Any) -> tuple[torch.Tensor]:
        given.update(arguments)
        return (torch.zeros(1, 10, 20, 3),)

    work = random_workload(5, 20, 10, regions=(2, 2, 1))
    gpu.render(SimpleNamespace(rasterization=rasterization), work, torch.rand(5, 3))
    bound = inspect.signature(module.rasterization).bind(**given)
    assert bound.arguments["viewmats"].shape == (1, 4, 4)


@pytest.mark.parametrize("chunk", [7, 3])
def test_dense_uplift_by_gradients(chunk: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gpu, "CHUNK", chunk)
    work = random_workload(60, 30, 20, regions=(4, 3, 2))
    embeddings = [torch.randn(len(codes), 7) for codes in work.codes]
    blending = gpu.render(stand_in(work), work, torch.eye(60))  # e_i(p)
    rows = [each[labels.long()] for each, labels in zip(embeddings, work.labels, strict=True)]
    expected = torch.stack([torch.einsum("hwn,hwd->nd", blending, each) for each in rows])
    assert expected.abs().max() > 1
    out = torch.zeros(3, 60, 7)
    gpu.dense_uplift(stand_in(work), work, embeddings, out)
    torch.testing.assert_close(out, expected, atol=1e-4, rtol=1e-4)
