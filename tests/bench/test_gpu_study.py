"""The study of one view on a GPU, on a CPU by the reference, with a stand-in for gsplat."""

from __future__ import annotations

import inspect
import sys
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from benchmarks import gpu
from benchmarks.gpu import Gpu
from benchmarks.gpu_rows import QUERIES, TESTS, answers_row
from benchmarks.study import run

from messages import refuses
from scoup import raster
from scoup_lab.bench import random_workload

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


@pytest.mark.usefixtures("_on_a_cpu", "quick_python")
def test_every_row_is_timed(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr("benchmarks.gpu_rows.TESTS", TESTS[:1])
    monkeypatch.setenv("PYTEST_XDIST_AUTO_NUM_WORKERS", "0")  # they run in one process, which starts at once
    monkeypatch.setitem(sys.modules, "gsplat", stand_in(random_workload(60, 30, 20)))
    rows = run(TINY, "gpu")["rows"]
    assert rows.pop(gpu.DIFFERENCE)["value"] < 1e-6
    tests, answers, build = (
        rows.pop(name) for name in ("tests", "answers of a scene, by the command line", "build")
    )
    assert tests == {"passed": 0, "failed": {}, "skipped": 1}
    assert answers == {"device": "cpu"}
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
    monkeypatch.setattr(gpu, "KernelTests", lambda _: SimpleNamespace(row=dict))  # run above
    rows = dict(TINY.measure({}))
    assert rows[gpu.THEIRS]["reason"].startswith("ModuleNotFoundError")
    assert rows["RGB"]["median_s"] > 0
    left = dict(TINY.measure({name: of for name, of in rows.items() if name != "RGB"}))
    assert list(left) == ["RGB"]
    assert gpu.THEIRS in Gpu.table({"rows": rows})


@pytest.mark.usefixtures("_on_a_cpu")
def test_a_lost_device_ends_the_command_after_its_row(monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(*_: object, **__: object) -> None:
        raise RuntimeError("an illegal memory access was encountered")

    rows = TINY.measure({})
    monkeypatch.setattr(raster, "render_cosines", lost)
    monkeypatch.setitem(sys.modules, "gsplat", stand_in(random_workload(60, 30, 20)))
    assert next(rows) == (
        "relevancy of a query, L = 8",
        {"reason": "RuntimeError: an illegal memory access was encountered"},
    )
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
