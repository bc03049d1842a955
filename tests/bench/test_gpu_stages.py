"""The stages of the GPU benchmark: each with interpreted kernels, and what they are compared with."""

from __future__ import annotations

import inspect
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from benchmarks.gpu import ROOT, gsplat, parity
from benchmarks.gpu.report import report
from benchmarks.gpu.runner import STAGES
from benchmarks.gpu.stage import QUICK, TINY, Stage, Unavailable

from scoup import raster
from scoup_lab.bench import random_scene_cameras, random_scene_gaussians, random_workload


def stage_on_a_cpu(**changes: Any) -> Stage:
    return Stage(torch.device("cpu"), TINY, float("inf"), **{"send": lambda message: None, **changes})


def written_by_the_command(folder: Path, *stages: str) -> dict[str, Any]:
    """What the command writes on a machine without a GPU."""
    out = folder / "gpu.json"
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "CUDA_VISIBLE_DEVICES": ""}
    command = [sys.executable, "-m", "benchmarks.gpu", "--quick", "--stages", *stages, "--out", str(out)]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(out.read_text())
    assert out.with_suffix(".md").read_text() == report(found)
    assert found["finished"]
    assert list(found["stages"]) == list(stages)
    return found


@pytest.mark.slow
def test_every_stage_runs(needs_triton: None, tmp_path: Path) -> None:
    """Parity has tests of its own: its suite is most of the tests of the kernels."""
    record = written_by_the_command(tmp_path, "timing", "build")
    for name, result in record["stages"].items():
        assert "reason" not in result, (name, result)
        assert result["rows"], name
        for row in result["rows"]:
            assert {"median_s", "value"} & set(row) or row["reason"] == "gsplat needs a CUDA device", (
                name,
                row,
            )
    page = report(record)
    assert "no time here means anything" in page
    assert all(f"## {STAGES[name]}" in page for name in record["stages"])
    assert "gsplat: RGB: gsplat needs a CUDA device" in page


SOME = """
import pytest
def test_a(): pass
def test_b(): assert 0, 'this one'
@pytest.mark.skip
def test_c(): pass
@pytest.fixture
def bad(): raise KeyError('oh')
def test_d(bad): pass
def test_e(): pass
"""


def run_suite(folder: Path, name: str, **changes: Any) -> dict[str, Any]:
    """The result."""
    stage = stage_on_a_cpu()
    for key, value in changes.items():
        setattr(stage, key, value)
    parity.parity(stage, (name,), folder)
    return stage.result


@pytest.fixture(scope="module")
def folder_of_suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("suite")
    (folder / "test_parity_some.py").write_text(SOME)
    return folder


@pytest.fixture
def suite(folder_of_suite: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a small suite, left again afterwards."""
    monkeypatch.chdir(folder_of_suite)
    return folder_of_suite


def test_parity_makes_a_row_of_each_test(suite: Path) -> None:
    rows = run_suite(suite, "test_parity_some.py", sizes=replace(TINY, tests=""))["rows"]
    outcomes = {row["name"].removeprefix("test_parity_some.py::test_"): row["outcome"] for row in rows}
    assert outcomes == {"a": "passed", "b": "failed", "d": "failed", "e": "passed"}
    assert "this one" in rows[1]["reason"]
    assert "oh" in rows[2]["reason"]


def test_parity_stops_when_the_time_is_up(suite: Path) -> None:
    result = run_suite(suite, "test_parity_some.py", deadline=0.0)
    assert (len(result["rows"]), result["reason"]) == (1, "no time was left")


def test_a_suite_that_cannot_be_collected_says_why(suite: Path) -> None:
    (suite / "test_parity_other.py").write_text("import no_such_package\n")
    with pytest.raises(Unavailable, match="No module named 'no_such_package'"):
        run_suite(suite, "test_parity_other.py")


@pytest.mark.slow
def test_the_suite_is_there_and_quick_is_what_runs_on_a_gpu() -> None:
    as_on_a_gpu = "import sys, pytest, torch; torch.cuda.is_available = lambda: True; sys.exit(pytest.main())"
    command = [sys.executable, "-c", as_on_a_gpu, *parity.SUITE, "-p", "no:cacheprovider", "--collect-only"]
    done = subprocess.run([*command, "-k", QUICK.tests], cwd=ROOT, capture_output=True, text=True, check=True)
    found = [line for line in done.stdout.splitlines() if "::" in line]
    assert all("seed1" not in name and "seed2" not in name for name in found)
    for name in ("channels", "region_sums", "votes", "codes", "a_build", "precisions", "with_the_reference"):
        assert any(f"{name}_on_a_gpu" in line for line in found), name
    assert not any("compile" in line or "ugly" in line for line in found)


def test_gsplat_takes_our_arguments() -> None:
    module = pytest.importorskip("gsplat")
    given: dict[str, Any] = {}

    def rasterization(**arguments: Any) -> tuple[torch.Tensor]:
        given.update(arguments)
        return (torch.zeros(1, 10, 20, 3),)

    camera = random_scene_cameras(1, 20, 10)[0]
    gsplat.render(
        SimpleNamespace(rasterization=rasterization), random_scene_gaussians(5), camera, torch.rand(5, 3)
    )
    bound = inspect.signature(module.rasterization).bind(**given)
    assert bound.arguments["viewmats"].shape == (1, 4, 4)


def test_a_gsplat_that_does_not_work_is_the_reason_of_all_its_rows() -> None:
    stage = stage_on_a_cpu()
    gsplat.compile_gsplat(stage)
    assert stage.no_gsplat == stage.result["rows"][0]["reason"]
    assert stage.no_gsplat.startswith(("gsplat needs a CUDA device", "gsplat is not installed"))
    with pytest.raises(Unavailable, match=stage.no_gsplat.split("(")[0].strip()):
        gsplat.load_gsplat(stage)


def test_dense_uplift_by_gradients() -> None:
    work = random_workload(60, 30, 20, regions=(4, 3, 2))
    projection = raster.project(work.gaussians, work.camera, "gsplat", "reference")

    def rasterization(colors: torch.Tensor, **_: object) -> tuple[torch.Tensor]:
        return (raster.render_channels(projection, colors)[0][None],)

    embeddings = [torch.randn(len(codes), 7) for codes in work.codes]
    expected = torch.zeros(3, 60, 7)
    for level, rows in enumerate(embeddings):
        painted, _ = raster.render_channels(projection, torch.eye(60))  # e_i(p)
        expected[level] = torch.einsum("hwn,hwd->nd", painted, rows[work.labels[level].long()])
    assert expected.abs().max() > 1
    for channels in (7, 3):
        out = torch.zeros(3, 60, 7)
        module = SimpleNamespace(rasterization=rasterization)
        gsplat.dense_uplift(module, work, embeddings, out, channels)
        torch.testing.assert_close(out, expected, atol=1e-4, rtol=1e-4)
