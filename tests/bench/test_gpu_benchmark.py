"""The benchmark of the GPU backend: every stage with interpreted kernels, and its parts."""

from __future__ import annotations

import importlib.util
import inspect
import json
import math
import multiprocessing
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.gpu import (
    agreement,
    building,
    conduct,
    expectations,
    parity,
    peer_building,
    region_sums,
    rendering,
    timing,
)
from benchmarks.gpu.__main__ import QUICK_PARITY, SMOKE_PARITY, Arguments, main, parse
from benchmarks.gpu.fewer_channels import KEPT, fewer_channels
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
from scoup.base.errors import InputError, OutputExistsError, UnknownNameError
from scoup.bench import count_evaluations, random_scene_cameras, random_scene_gaussians, room_workload

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
            known = "median_s" in row or row.get("agrees")
            assert known or row["reason"] == "gsplat needs a CUDA device", (name, row)
    stages = record["stages"]
    assert stages["rendering"]["pictures"]["relevancy, ours against decoded, greatest difference"] < 1e-5
    assert all(value < 1e-5 for value in stages["sums"]["agreement"].values())
    assert len(stages["precision"]["differences"]) == 4
    assert all(row["pixels_of_another_order"] <= 1e-3 for row in stages["precision"]["differences"])
    bounded = [row for row in stages["roofline"]["rows"] if "bound_s" in row]
    assert len(bounded) == len(stages["roofline"]["rows"]) >= 9  # a kernel without a formula is not counted
    assert {row["amount"] for row in stages["scaling"]["rows"] if row["grows"] == "levels"} == {1, 2}
    page = out.with_suffix(".md").read_text()
    assert page == report(record)
    assert all(f"## {heading}" in page for _, heading in STAGES.values())


def test_walking_counts_what_paints(needs_triton: None) -> None:
    with interpreter() as worker:
        found = worker.submit(walked).result()
    gaussians, camera = random_scene_gaussians(40), random_scene_cameras(1, 19, 13)[0]
    for painting, lanes in found:
        assert painting == count_evaluations(gaussians, camera) > 0
        assert lanes >= painting


def walked() -> list[tuple[int, int]]:
    from benchmarks.gpu.walking import walk

    view = raster.project(random_scene_gaussians(40), random_scene_cameras(1, 19, 13)[0], "inria", "triton")
    walks = [walk(view, chunk) for chunk in (64, 32, 16)]  # pyright: ignore
    return [(item.painting, item.lanes) for item in walks]


@pytest.mark.parametrize("capability", [80, 90])
def test_kernels_compile(needs_triton: None, tmp_path: Path, capability: int) -> None:
    from benchmarks.gpu.ceilings import chain_kernel
    from benchmarks.gpu.walking import walk_kernel

    for power, values in ((False, F32), (True, F32), (False, "*fp64")):
        types = {"values": values, "factor": "fp32", "term": "fp32", "rounds": "i32"}
        constants = {"POWER": power, "UNROLLED": 16, "BLOCK": 2048}
        assert compile_kernel(chain_kernel, types, constants, 8, capability, tmp_path).spilled == 0
    lists = {"records": F32, "starts": I64, "chunks": I32, "painting": I32}
    types = {
        **lists,
        **dict.fromkeys(("width", "height", "across"), "i32"),
        "alpha_max": "fp32",
        "stop": "fp32",
    }
    for chunk in (16, 32):
        constants = {"STOP_INCLUSIVE": True, "TILE": 8, "CHUNK": chunk}
        compile_kernel(walk_kernel, types, constants, 2, capability, tmp_path)


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


def test_rows_tell_what_is_known_from_the_first_runs_on() -> None:
    told: list[list[timing.Row]] = []
    rows: list[timing.Row] = []
    asked: list[str] = []

    def about_to(name: str) -> str | None:
        asked.append(name)
        return "it hung before" if name == "b" else None

    works = [Work(name, lambda: None) for name in "abc"]
    measure(
        works, CPU, 2, into=rows, about_to=about_to, known=lambda: told.append([dict(row) for row in rows])
    )
    assert [row.get("repeats") for row in told[0]] == [0, None, None]
    assert [row.get("repeats") for row in told[-1]] == [2, None, 2]
    assert told[-1][1] == {"name": "b", "reason": "it hung before"}
    assert asked == ["a", "b", "c", "c", "a", "a", "c"]


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


def conductor(stages: dict, deadline: float = float("inf"), quiet_s: float = 60.0) -> conduct.Conductor:
    return conduct.Conductor({"stages": stages}, SMOKE, True, deadline, quiet_s, lambda: None)


def ailing(names, sizes, interpreted, deadline, ceilings, to, left_out, no_peer) -> None:
    """Stands for a worker: of the second stage, "bad" kills it and "slow" hangs, unless left out."""
    for name in names:
        to.send(("begin", name))
        rows = []
        for what in ("good", "bad", "slow", "last"):
            to.send(("doing", name, what))
            if what in left_out[name]:
                rows.append({"name": what, "reason": left_out[name][what]})
            elif name == "rendering" and what == "bad":
                to.close()
                os._exit(7)
            elif name == "rendering" and what == "slow":
                to.send(("doing", name, ""))
                time.sleep(600)
            else:
                rows.append({"name": what, "median_s": 1.0})
            to.send(("save", name, {"rows": rows}))
        to.send(("end", name, {"rows": rows}))


def test_what_kills_a_process_or_hangs_costs_its_own_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conduct, "work_through", ailing)
    stages: dict[str, dict] = {}
    conductor(stages, quiet_s=15.0).run(("ceilings", "rendering", "sums"))
    assert list(stages) == ["ceilings", "rendering", "sums"]
    for name in ("ceilings", "sums"):
        assert [row["median_s"] for row in stages[name]["rows"]] == [1.0] * 4
    assert stages["rendering"] == {
        "rows": [
            {"name": "good", "median_s": 1.0},
            {"name": "bad", "reason": "its process ended with 7"},
            {"name": "slow", "reason": "it hung and was stopped"},
            {"name": "last", "median_s": 1.0},
        ]
    }


def test_nothing_is_begun_when_the_time_is_up(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conduct, "work_through", None)  # would raise
    stages: dict[str, dict] = {"sums": {"rows": [{"name": "known"}]}}
    conductor(stages, time.time() + conduct.RESERVE - 1).run(("sums", "building"))
    assert stages["sums"] == {"rows": [{"name": "known"}]}
    assert stages["building"] == {"rows": [], "reason": "no time was left"}


def test_a_stage_that_hangs_is_left() -> None:
    receiver, sender = multiprocessing.Pipe(duplex=False)
    for message in (("begin", "ceilings"), ("end", "ceilings", {"rows": []}), ("begin", "sums")):
        sender.send(message)
    sender.send(("doing", "sums", "what hangs"))
    sender.send(("save", "sums", {"rows": [{"name": "known"}]}))
    results: dict[str, dict[str, object]] = {}
    heard = conduct.Heard()
    conductor(results, quiet_s=0.1).listen(receiver, heard, {})
    assert (heard.running, heard.ended, heard.doing) == ("sums", ["ceilings"], "what hangs")
    assert heard.silent
    assert results["sums"] == {"rows": [{"name": "known"}], "reason": conduct.UNFINISHED}
    assert results["ceilings"] == {"rows": []}


def test_what_is_known_is_written_whatever_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def odd(self: conduct.Conductor, stages: object) -> None:
        self.record["stages"]["sums"] = {
            "rows": [{"no": "name"}],
            "agreement": {"a": math.nan, "b": math.inf},
        }

    monkeypatch.setattr(conduct.Conductor, "run", odd)
    out = tmp_path / "gpu.json"
    conduct.conduct(out, SMOKE, ("sums",), "smoke", interpreted=True, parity=False)
    record = json.loads(out.read_text())
    assert record["finished"]
    assert record["stages"]["sums"]["agreement"] == {"a": "nan", "b": "inf"}
    assert "could not be made" in out.with_suffix(".md").read_text()


def test_what_an_earlier_process_knew_stays() -> None:
    earlier = {
        "rows": [{"name": "a", "median_s": 1.0}, {"name": "b", "median_s": 2.0}, {"name": "c"}],
        "facts": 1,
        "reason": "died",
    }
    found = conduct.merged(
        {"rows": [{"name": "a", "median_s": 3.0}, {"name": "c", "reason": "hung"}]}, earlier
    )
    assert found == {
        "rows": [
            {"name": "a", "median_s": 3.0},
            {"name": "c", "reason": "hung"},
            {"name": "b", "median_s": 2.0},
        ],
        "facts": 1,
    }


def test_what_keeps_on_is_told_and_stops_in_time() -> None:
    from benchmarks.gpu.context import Context

    told: list[str] = []
    context = Context(torch.device("cpu"), SMOKE, time.time() + 60, lambda result: None, told.append)
    context.heartbeat("vote", 1, 9)
    context.heartbeat("vote", 2, 9)
    assert told == [""]
    context.deadline = 0.0
    with pytest.raises(Unavailable, match="no time was left, at 3 of 9 of: vote"):
        context.heartbeat("vote", 3, 9)
    assert context.once(Work("build", lambda: None)) == {"name": "build", "reason": "no time was left"}


def test_other_numbers_do_not_agree() -> None:
    expected = torch.tensor([10.0, 0.0, -5.0] * 400)
    found = expected.clone()
    found[:2] += 1.0  # two numbers of 1200 may be decisions that turned
    assert agreement.difference(found, expected)["agrees"]
    assert agreement.difference(found, expected)["difference"] == pytest.approx(0.1)
    for wrong in (expected * 1.01, torch.full_like(expected, torch.nan), torch.zeros_like(expected)):
        assert not agreement.difference(wrong, expected)["agrees"]


def test_the_peer_is_compiled_ahead(monkeypatch: pytest.MonkeyPatch) -> None:
    def found(program: str, seconds: float) -> dict:
        building = peer_building.PeerBuilding((sys.executable, "-c", program))
        building.start()
        return building.finish(time.time() + seconds)

    monkeypatch.setattr(importlib.util, "find_spec", lambda name: object())
    assert found("pass", 60)["reason"] == ""
    failed = found("print('nvcc: x.cu(3): error: no such thing'); raise SystemExit(1)", 60)
    assert failed["reason"].startswith("gsplat does not work here: nvcc: x.cu(3): error: no such thing")
    assert "was not compiled within" in found("import time; time.sleep(600)", 1.0)["reason"]
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert found("pass", 60) == {"reason": peer_building.MISSING}


def test_the_peer_is_compiled_for_few_channels(tmp_path: Path) -> None:
    source = tmp_path / "gsplat" / "cuda" / "csrc"
    source.mkdir(parents=True)
    asked = "".join(f"        __LAUNCH_KERNEL__({n})\n" for n in (1, 3, 32, 513))
    (source / "a.cpp").write_text(f"#define __LAUNCH_KERNEL__(N) \\\n case N:\n{asked}rest\n")
    (source / "b.cu").write_text("__INS__(2)\n__INS__(128)\n#undef __INS__\n")
    assert fewer_channels(tmp_path) == 3
    assert (source / "b.cu").read_text() == "__INS__(128)\n#undef __INS__\n"
    left = (source / "a.cpp").read_text()
    assert re.findall(r"\((\w+)\)", left) == ["N", "3", "32"]
    used = {3, *(width for n in FULL.channels for at in (32, 128) for width in (min(n, at), n % at or at))}
    assert used <= set(KEPT)


def test_parity_reports_what_pytest_says(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    found = parity.run_parity(only=SMOKE_PARITY)
    assert found["passed"]
    assert found["counts"]["passed"] == 1
    suite = tmp_path / "test_some.py"
    suite.write_text(
        "import os, time\n\ndef test_a(): pass\n\ndef test_b(): assert 0, 'this one'\n\n"
        "def test_dies(): os._exit(9)\n\ndef test_slow(): time.sleep(99)\n\ndef test_z(): pass\n"
    )
    monkeypatch.setattr(parity, "SUITE", (str(suite),))
    monkeypatch.setattr(parity, "ROOT", tmp_path)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)  # one process
    found = parity.run_parity(only="test_a or test_b")
    assert not found["passed"]
    assert found["reason"] == "1 failed"
    assert found["counts"] == {"failed": 1, "passed": 1}
    assert [name.split("::")[-1] for name in found["failed"]] == ["test_b"]
    assert "this one" in next(iter(found["texts"].values()))
    monkeypatch.setattr(parity, "TEST_SECONDS", 3.0)
    found = parity.run_parity()
    assert found["counts"] == {"failed": 3, "passed": 2}
    assert [name.split("::")[-1] for name in found["failed"]] == ["test_b", "test_dies", "test_slow"]
    monkeypatch.setattr(parity, "TEST_SECONDS", 60.0)
    found = parity.run_parity(8.0, only="test_a or test_slow")
    assert found["reason"] == "stopped after 8 s"
    assert found["counts"] == {"passed": 1, "begun": 1}
    assert not found["passed"]
    monkeypatch.setattr(parity, "NEEDED", ("pytest", "no_such_package"))
    assert "no_such_package must be installed" in parity.run_parity()["reason"]


def test_the_quick_parity_is_what_runs_on_a_gpu() -> None:
    command = [sys.executable, "-m", "pytest", *parity.SUITE, "-p", "no:cacheprovider", "--collect-only"]
    done = subprocess.run(
        [*command, "-k", QUICK_PARITY], cwd=ROOT, capture_output=True, text=True, check=True
    )
    found = [line for line in done.stdout.splitlines() if "::" in line]
    assert all("seed1" not in name and "seed2" not in name for name in found)
    for name in ("channels", "region_sums", "votes", "codes", "a_build", "precisions", "with_the_reference"):
        assert any(f"{name}_on_a_gpu" in line for line in found), name
    assert not any("compile" in line or "ugly" in line for line in found)


def test_the_peer_takes_our_arguments() -> None:
    gsplat = pytest.importorskip("gsplat")
    camera = random_scene_cameras(1, 20, 10)[0]
    arguments = Gsplat.arguments(random_scene_gaussians(5), camera, torch.rand(5, 3), False, 32)
    bound = inspect.signature(gsplat.rasterization).bind(**arguments)
    assert bound.arguments["viewmats"].shape == (1, 4, 4)
    with pytest.raises(Unavailable, match="needs a CUDA device"):
        Gsplat.found(torch.device("cpu"))


def test_dense_uplift_by_gradients() -> None:
    work = room_workload(60, 30, 20, regions=(4, 3, 2))
    view = raster.project(work.gaussians, work.camera, "gsplat", "reference")

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
    summed = row(region_sums.OURS, 2e-3, **{rendering.RGB: 3.0, region_sums.DENSE: 0.01})
    build = {**row(building.ours_name("paper"), 2.5, **{building.PAPER: 0.04}), "peak_bytes": 4e9}
    settings = {"interpreted": False, "n_atoms": [64, 128], "build_views": FULL.build_views}
    stages = {
        "rendering": {"rows": [ask]},
        "sums": {"rows": [summed]},
        "building": {"rows": [build]},
        "precision": {"differences": [{"name": "fp16x3", "pixels_of_another_order": 1e-4}]},
    }
    lines = expectations.expectations({"settings": settings, "stages": stages})
    assert [(line[1], line[2]) for line in lines] == [
        ("1.2 x", "yes"), ("500 /s", "no"), ("5 x", "no"), ("3 x", "no"), ("100 x", "yes"), ("25 x", "yes"),
        ("2.5 s", "yes"), ("4 GB", "no"), ("-", "not measured"), ("-", "not measured"), ("0.0001", "yes"),
    ]  # fmt: skip
    nothing = expectations.expectations({"settings": settings, "stages": {}})
    assert [line[0] for line in nothing] == [line[0] for line in lines]
    assert {(line[1], line[2]) for line in nothing} == {("-", "not measured")}


def test_the_command_line() -> None:
    assert parse([]) == Arguments()
    found = parse(
        ["--quick", "--budget-seconds", "500", "--no-parity", "--no-peer"]
        + ["--out", "a.json", "--stages", "sums", "large"]
    )
    assert found == Arguments(True, False, 500.0, ("sums", "large"), False, False, Path("a.json"), False)
    assert parse(["--stages", "--parity"]).stages == ()


def test_nothing_must_be_installed(tmp_path: Path) -> None:
    program = (
        "import sys; sys.meta_path = [f for f in sys.meta_path if 'Editable' not in type(f).__name__ and "
        "'scoup' not in type(f).__module__]; sys.modules['tyro'] = None; import benchmarks.gpu.__main__, scoup; "
        "print(scoup.__file__)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert Path(done.stdout.strip()) == ROOT / "src" / "scoup" / "__init__.py"


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
