"""The benchmark of the GPU backend: every stage with interpreted kernels, and its parts."""

from __future__ import annotations

import inspect
import json
import multiprocessing
import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.gpu import building, conduct, expectations, parity, rendering, timing, uplift
from benchmarks.gpu.__main__ import SMOKE_PARITY, Arguments, main
from benchmarks.gpu.peers import Gsplat, dense_uplift, plain_adam
from benchmarks.gpu.report import report
from benchmarks.gpu.roofline import add_bound
from benchmarks.gpu.sizes import FULL, SMOKE
from benchmarks.gpu.timing import Clock, Unavailable, Work, add_ratios, measure
from benchmarks.gpu.worker import STAGES

from coding.plain_adam import plain_adam as oracle
from compiling import F32, I32, I64, compile_kernel
from interpreting import interpreter
from scoup import raster
from scoup.bench import count_evaluations, make_room, room_cameras, room_workload
from scoup.errors import InputError, OutputExistsError, UnknownNameError

ROOT = Path(__file__).resolve().parents[2]
CPU = Clock(torch.device("cpu"))


def test_every_stage_runs(needs_triton: None, tmp_path: Path) -> None:
    out = tmp_path / "gpu.json"
    command = [sys.executable, "-m", "benchmarks.gpu", "--smoke", "--no-parity", "--out", str(out)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    record = json.loads(out.read_text())
    assert record["finished"]
    assert record["parity"] == {"reason": "not run"}
    assert list(record["stages"]) == list(STAGES)
    for name, result in record["stages"].items():
        assert "reason" not in result, (name, result)
        assert result["rows"], name
        for row in result["rows"]:
            assert "median_s" in row or row["reason"] == "gsplat needs a CUDA device", (name, row)
    stages = record["stages"]
    assert stages["rendering"]["pictures"]["relevancy, ours against decoded, greatest difference"] < 1e-5
    assert all(value < 1e-5 for value in stages["uplift"]["agreement"].values())
    assert len(stages["precision"]["differences"]) == 4
    assert all(row["pixels_of_another_order"] <= 1e-3 for row in stages["precision"]["differences"])
    bounded = [row for row in stages["roofline"]["rows"] if "bound_s" in row]
    assert len(bounded) == len(stages["roofline"]["rows"]) >= 11  # a kernel without a formula is not counted
    assert {row["amount"] for row in stages["scaling"]["rows"] if row["grows"] == "levels"} == {1, 2}
    page = out.with_suffix(".md").read_text()
    assert page == report(record)
    assert all(f"## {heading}" in page for _, heading in STAGES.values())


def test_walking_counts_what_paints(needs_triton: None) -> None:
    with interpreter() as worker:
        found = worker.submit(walked).result()
    gaussians, camera = make_room(40), room_cameras(1, 19, 13)[0]
    for painting, lanes in found:
        assert painting == count_evaluations(gaussians, camera) > 0
        assert lanes >= painting


def walked() -> list[tuple[int, int]]:
    from benchmarks.gpu.walking import walk

    view = raster.look(make_room(40), room_cameras(1, 19, 13)[0], "inria", "triton")
    walks = [walk(view, pixels, chunk) for pixels, chunk in ((256, 32), (128, 16), (64, 16))]  # pyright: ignore
    return [(item.painting, item.lanes) for item in walks]


@pytest.mark.parametrize("capability", [80, 90])
def test_kernels_compile(needs_triton: None, tmp_path: Path, capability: int) -> None:
    from benchmarks.gpu.ceilings import chain_kernel
    from benchmarks.gpu.walking import walk_kernel

    for power, values in ((False, F32), (True, F32), (False, "*fp64")):
        types = {"values": values, "factor": "fp32", "term": "fp32", "rounds": "i32"}
        constants = {"POWER": power, "UNROLLED": 16, "BLOCK": 2048}
        assert compile_kernel(chain_kernel, types, constants, 8, capability, tmp_path).spilled == 0
    lists = {"pair_ids": I32, "corners": F32, "records": F32, "starts": I64, "chunks": I32, "painting": I32}
    types = {
        **lists,
        **dict.fromkeys(("width", "height", "across"), "i32"),
        "alpha_max": "fp32",
        "stop": "fp32",
    }
    for pixels, chunk in ((256, 32), (64, 16)):
        constants = {"STOP_INCLUSIVE": True, "TILE": 16, "PIXELS": pixels, "CHUNK": chunk}
        compile_kernel(walk_kernel, types, constants, 4, capability, tmp_path)


def test_what_fails_is_a_row_with_a_reason() -> None:
    calls: list[str] = []

    def at_last() -> None:
        calls.append("at last")
        if len(calls) > 4:
            raise ValueError("too often")

    def missing() -> None:
        raise Unavailable("is not here")

    works = [
        Work("good", lambda: time.sleep(1e-3), note="sleeps"),
        Work("missing", missing),
        Work("at last", at_last),
    ]
    rows = measure(works, CPU, 3)
    assert rows[0]["repeats"] == 3
    assert 1e-3 <= rows[0]["median_s"] < 0.1
    assert rows[0]["runs_a_repeat"] > 1
    assert rows[1] == {"name": "missing", "reason": "is not here"}
    assert rows[2]["reason"] == "ValueError: too often"
    assert "median_s" not in rows[2]
    add_ratios(rows, {"good": ["good", "unknown"], "missing": ["missing"]})
    assert all("over" not in row for row in rows)
    late = measure(works[:1], CPU, 3, time_is_up=lambda: True)
    assert late[0]["reason"] == "no time was left"


def test_ratios_are_to_the_fastest_of_the_other() -> None:
    rows = [{"name": name, "median_s": value} for name, value in (("a", 6.0), ("b", 3.0), ("c", 2.0))]
    add_ratios(rows, {"peer": ["b", "c"]})
    assert rows[0]["over"] == {"peer": 3.0}
    assert "over" not in rows[1]


def test_rows_known_before_the_device_was_lost_stay(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(self: Clock) -> None:
        raise timing.DeviceLost("gone")

    monkeypatch.setattr(Clock, "recover", lost)
    rounds: list[int] = []

    def break_it() -> None:
        rounds.append(1)
        if len(rounds) > 1:
            raise RuntimeError("illegal address")

    kept: list[timing.Row] = []
    with pytest.raises(timing.DeviceLost):
        measure([Work("breaks", break_it), Work("good", lambda: None)], CPU, 3, warm_up=False, into=kept)
    assert kept[0]["reason"] == "RuntimeError: illegal address"
    assert kept[1]["repeats"] >= 1


def dying(names, sizes, interpreted, deadline, ceilings, to) -> None:
    """Stands for a worker: the second stage kills it."""
    for name in names:
        to.send(("begin", name))
        to.send(("save", name, {"rows": [{"name": name}]}))
        if name == "rendering":
            to.close()
            os._exit(7)
        to.send(("end", name, {"rows": [{"name": name}, {"name": "more"}]}))


def test_a_stage_that_kills_its_process_leaves_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conduct, "work_through", dying)
    record = {"stages": {}}
    names = ("ceilings", "rendering", "uplift")
    conduct.run_stages(record, SMOKE, names, True, float("inf"), lambda: None)
    stages = record["stages"]
    assert list(stages) == list(names)
    assert stages["rendering"] == {"rows": [{"name": "rendering"}], "reason": "its process ended with 7"}
    assert len(stages["ceilings"]["rows"]) == len(stages["uplift"]["rows"]) == 2


def test_a_stage_that_hangs_is_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conduct, "GRACE", 0.1)
    receiver, sender = multiprocessing.Pipe(duplex=False)
    results: dict[str, dict[str, object]] = {}
    for message in (("begin", "ceilings"), ("end", "ceilings", {"rows": []}), ("begin", "uplift")):
        sender.send(message)
    sender.send(("save", "uplift", {"rows": [{"name": "known"}]}))
    assert conduct.listen(receiver, results, time.time() + 0.1, lambda: None) == ("uplift", 1)
    assert results["uplift"] == {"rows": [{"name": "known"}], "reason": conduct.UNFINISHED}
    assert results["ceilings"] == {"rows": []}


def test_parity_reports_what_pytest_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = parity.run_parity(only=SMOKE_PARITY)
    assert found["passed"]
    assert found["counts"]["passed"] == 1
    suite = tmp_path / "test_some.py"
    suite.write_text(
        "import time\n\ndef test_a(): pass\n\ndef test_b(): assert 0\n\ndef test_slow(): time.sleep(99)\n"
    )
    monkeypatch.setattr(parity, "SUITE", (str(suite),))
    monkeypatch.setattr(parity, "ROOT", tmp_path)
    found = parity.run_parity(only="test_a or test_b")
    assert not found["passed"]
    assert found["counts"] == {"failed": 1, "passed": 1, "deselected": 1}
    assert [name.split("::")[-1] for name in found["failed"]] == ["test_b"]
    found = parity.run_parity(8.0, only="test_slow")
    assert found["reason"] == "stopped after 8 s"
    assert found["counts"] == {}


def test_the_peer_takes_our_arguments() -> None:
    gsplat = pytest.importorskip("gsplat")
    camera = room_cameras(1, 20, 10)[0]
    arguments = Gsplat.arguments(make_room(5), camera, torch.rand(5, 3), False, 32)
    bound = inspect.signature(gsplat.rasterization).bind(**arguments)
    assert bound.arguments["viewmats"].shape == (1, 4, 4)
    with pytest.raises(Unavailable, match="needs a CUDA device"):
        Gsplat.found(torch.device("cpu"))


def test_dense_uplift_by_gradients() -> None:
    work = room_workload(60, 30, 20, regions=(4, 3, 2))
    view = raster.look(work.gaussians, work.camera, "gsplat", "reference")

    def rasterization(colors: torch.Tensor, **_: object) -> tuple[torch.Tensor]:
        return (raster.render_channels(view, colors)[0][None],)

    embeddings = [torch.randn(len(codes), 7) for codes in work.codes]
    expected = torch.zeros(3, 60, 7)
    for level, rows in enumerate(embeddings):
        painted, _ = raster.render_channels(view, torch.eye(60))  # e_i(p)
        expected[level] = torch.einsum("hwn,hwd->nd", painted, rows[work.labels[level].long()])
    assert expected.abs().max() > 1
    for channels in (7, 3):
        out = torch.zeros(3, 60, 7)
        dense_uplift(Gsplat(SimpleNamespace(rasterization=rasterization)), work, embeddings, out, channels)  # pyright: ignore
        torch.testing.assert_close(out, expected, atol=1e-4, rtol=1e-4)


def test_the_plain_solver_is_that_of_the_oracle() -> None:
    rows = torch.nn.functional.normalize(torch.randn(30, 8), dim=1)
    atoms = torch.nn.functional.normalize(torch.randn(6, 8), dim=1)
    found, weights = plain_adam(rows, atoms, 3, 20, 1e-2)
    expected, _, _ = oracle(rows, atoms, rows @ atoms.T * 4.0, 3, 20, 1e-2)
    torch.testing.assert_close(found, expected, atol=1e-4, rtol=0)
    assert bool(((weights > 0).sum(1) == 3).all())
    torch.testing.assert_close(weights.sum(1), torch.ones(30))


def test_the_bound_is_the_longest_of_the_times() -> None:
    from benchmarks.gpu import ceilings
    from benchmarks.gpu.counting import Count

    rates = {ceilings.COPY: 100.0, ceilings.FLOAT32: 10.0, ceilings.TF32: 4.0}
    row = add_bound({"median_s": 8.0}, Count(200.0, 20.0, tensor=16.0, tensor_kind="tf32"), rates)
    assert row["bounds_s"] == {ceilings.COPY: 2.0, ceilings.FLOAT32: 2.0, ceilings.TF32: 4.0}
    assert (row["bound_by"], row["bound_s"], row["share_of_bound"], row["gap_s"]) == (
        ceilings.TF32,
        4.0,
        0.5,
        4.0,
    )


def test_expectations_are_judged_by_the_rows() -> None:
    def row(name: str, seconds: float, **over: float) -> dict[str, object]:
        return {"name": name, "median_s": seconds, "over": over}

    ask = row(rendering.relevancy_name(64), 2e-3, **{rendering.RGB: 1.2, rendering.DECODED: 0.2})
    lift = row(uplift.ours_name(64), 2e-3, **{rendering.RGB: 3.0, uplift.DENSE: 0.01})
    build = {**row(building.ours_name("paper"), 2.5, **{building.PAPER: 0.04}), "peak_bytes": 4e9}
    settings = {"interpreted": False, "n_atoms": [64, 128], "build_views": FULL.build_views}
    stages = {
        "rendering": {"rows": [ask]},
        "uplift": {"rows": [lift]},
        "building": {"rows": [build]},
        "precision": {"differences": [{"name": "fp16x3", "pixels_of_another_order": 1e-4}]},
    }
    lines = expectations.expectations({"settings": settings, "stages": stages})
    assert [(line[1], line[2]) for line in lines] == [
        ("1.2 x", "yes"), ("500 /s", "no"), ("5 x", "no"), ("3 x", "no"), ("100 x", "yes"), ("25 x", "yes"),
        ("2.5 s", "yes"), ("4 GB", "no"), ("0.0001", "yes"),
    ]  # fmt: skip
    assert expectations.expectations({"settings": settings, "stages": {}}) == []


def test_what_cannot_run_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(UnknownNameError, match="stage"):
        main(Arguments(smoke=True, stages=("render",)))
    with pytest.raises(InputError, match="not both"):
        main(Arguments(smoke=True, quick=True))
    with pytest.raises(InputError, match="needs --out"):
        main(Arguments(smoke=True))
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="finds no GPU"):
        main(Arguments())
    (tmp_path / "gpu.md").write_text("kept")
    with pytest.raises(OutputExistsError):
        main(Arguments(smoke=True, out=tmp_path / "gpu.json"))
    assert (tmp_path / "gpu.md").read_text() == "kept"
