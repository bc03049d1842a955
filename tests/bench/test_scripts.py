"""The measuring scripts of benchmarks/, tiny, from arguments to files."""

from __future__ import annotations

import importlib
import json
from pathlib import Path
from types import ModuleType

import pytest
import torch

from scoup.base.errors import InputError, OutputExistsError
from scoup.coding.exact import EFFORTS
from scoup_lab.bench import usable_backends

ROOT = Path(__file__).resolve().parents[2]
BACKENDS = usable_backends()[0]
SMALL = {"width": 30, "height": 20}


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch):
    def load(name: str) -> ModuleType:
        monkeypatch.syspath_prepend(str(ROOT))
        return importlib.import_module(f"benchmarks.{name}")

    return load


def test_stages_of_several_scenes(script, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    raster = script("raster")
    out = tmp_path / "raster.json"
    arguments = raster.Arguments(
        n_gaussians=(50, 90), threads=(1, 2), repeats=2, reference_repeats=1, reference_up_to=60, kitchen=False,
        clock_ghz=2.0, stages=("project", "alpha"), out=out, **SMALL,
    )  # fmt: skip
    record = raster.main(arguments)
    assert json.loads(out.read_text()) == record
    of_reference = [row for row in record["rows"] if row["backend"] == "reference"]
    assert {(row["gaussians"], row["repeats"]) for row in of_reference} == {(50, 1)}
    assert record["settings"]["reference_left_out"] == ["room of 90"]
    bound = record["bound"]["rows"][0]
    assert bound["fraction"] == pytest.approx(bound["evaluations"] / 16 * 11 / 2e9 / bound["measured_s"])
    printed = capsys.readouterr().out
    assert "the reference was not run on room of 90" in printed
    assert "clock 2.00 GHz (option)" in printed
    with pytest.raises(OutputExistsError):
        raster.main(arguments)


@pytest.mark.data
def test_kitchen_is_a_workload(script, data_folder: Path):
    if not (data_folder / "kitchen").is_dir():
        pytest.skip(f"no kitchen in {data_folder}")
    work = script("raster").kitchen_workload(data_folder / "kitchen")
    assert work.name == "kitchen"
    assert work.labels.shape == (3, 720, 960)
    assert [len(codes) for codes in work.codes] == [int(level.max()) + 1 for level in work.labels]
    assert int(work.labels.min()) == -1


@pytest.mark.parametrize("backend", BACKENDS)
def test_slopes_of_every_sweep(script, tmp_path: Path, capsys: pytest.CaptureFixture[str], backend: str):
    scaling = script("scaling")
    arguments = scaling.Arguments(
        (backend,), n_gaussians=60, sizes=(40, 80), zooms=(0.5, 1.0), views=(1, 2), regions=(2, 4), levels=(1, 2),
        repeats=1, out=tmp_path / "scaling.json", **SMALL,
    )  # fmt: skip
    record = scaling.main(arguments)
    assert json.loads((tmp_path / "scaling.json").read_text()) == record
    assert {item["grows"] for item in record["slopes"]} == set(arguments.sweeps)
    assert {item["stage"] for item in record["slopes"] if item["grows"] == "levels"} == set(scaling.LEVELS)
    assert all(item["standard_error"] is None for item in record["slopes"])  # two sizes leave none
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(record["slopes"])


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_whole_build(script, tmp_path: Path, capsys: pytest.CaptureFixture[str], backend: str):
    lerf_sized = script("lerf_sized")
    arguments = lerf_sized.Arguments(
        n_gaussians=80, views=3, regions=(6, 4, 2), solver="adam", epochs=3, n_atoms=8, k=2, backend=backend,
        threads=1, out=tmp_path / "lerf.json", **SMALL,
    )  # fmt: skip
    record = lerf_sized.main(arguments)
    assert json.loads((tmp_path / "lerf.json").read_text()) == record
    assert record["settings"]["backend"] == backend
    assert {"coding s", "coding m", "coding l", "region sums", "after vote"} <= set(record["seconds"])
    assert sum(record["seconds"].values()) == pytest.approx(record["total_s"], abs=0.1)
    assert record["coded_gaussians"] > 0
    assert "peak memory" in capsys.readouterr().out


@pytest.mark.slow
def test_every_form_of_coding(script, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    coding = script("coding")
    arguments = coding.Arguments(
        regions=(90, 150), repeats=2, dim=24, n_atoms=8, k=3, threads=1, adam_epochs=20, adam_up_to=100,
        autoencoder_steps=200, gap_regions=30, out=tmp_path / "coding.json",
    )  # fmt: skip
    record = coding.main(arguments)
    assert json.loads((tmp_path / "coding.json").read_text()) == record
    small, large = record["sizes"]
    assert (small["adam"]["epochs"], "adam" in large) == (20, False)
    assert (small["autoencoder"]["epochs"], large["autoencoder"]["epochs"]) == (100, 66)
    assert len(record["extrapolated"]) == 2  # Adam's whole fit, and the autoencoder's at the larger size
    for size in record["sizes"]:
        for fit in size["exact"].values():
            assert len(fit["loss"]) == len(fit["seconds"]["all"]) == 2
            parts = sum(part["all"][0] for part in fit["parts_s"].values())
            assert parts <= fit["seconds"]["all"][0] + 1e-9
        assert set(EFFORTS) < set(size["exact"])
        assert set(size["epoch_s"]) == {coding.GRAM, coding.PLAIN}
        assert -1e-6 < size["gap"]["mean"] <= size["gap"]["greatest"]
        assert 0.5 < size["gap"]["optimal"] <= 1
    below = small["adam"]["exact_below"]
    assert below is not None
    assert max(small["exact"][below["schedule"]]["loss"]) < small["adam"]["loss"]
    printed = capsys.readouterr().out
    assert "no fit by Adam was run to its end on 150 regions" in printed
    assert "autoencoder, 150 regions: the time is 100 epochs" in printed
    with pytest.raises(OutputExistsError):
        coding.main(arguments)


def test_the_best_codes_are_those_of_every_support(script):
    forms = script("coding_forms")
    oracle = importlib.import_module("tests.coding.coders").best_of_all_supports
    generator = torch.Generator().manual_seed(0)
    rows, atoms = (
        torch.nn.functional.normalize(torch.randn(count, 5, generator=generator) + 0.3, dim=1)
        for count in (20, 9)
    )
    atoms[3] = atoms[1]  # supports that hold both have no unique solution
    best = forms.best_cosines((rows @ atoms.T).double(), (atoms @ atoms.T).double(), 3)
    torch.testing.assert_close(best, oracle(rows @ atoms.T, atoms @ atoms.T, 3), atol=1e-6, rtol=0)


def test_what_it_costs_to_ask(script, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    query = script("query")
    out = tmp_path / "query.json"
    arguments = query.Arguments(n_gaussians=200, n_atoms=8, repeats=2, command_repeats=1, out=out, **SMALL)
    record = query.main(arguments)
    assert json.loads(out.read_text()) == record
    assert {stage: len(times) for stage, times in record["processor_seconds"].items()} == {
        stage: 1 if stage == "scoup query" else 2 for stage in query.STAGES
    }
    assert "query, same camera" in capsys.readouterr().out
    with pytest.raises(OutputExistsError):
        query.main(arguments)


def test_the_rarest_objects(script):
    objects = torch.tensor([0] * 5 + [1] * 4 + [2] * 3 + [7] * 2)
    rare = script("coding_forms").rarest_rows(objects)
    assert rare.nonzero()[:, 0].tolist() == [12, 13]


def test_extraction_against_the_literal_rules(script, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    extract = script("extract")
    out = tmp_path / "extract.json"
    arguments = extract.Arguments(
        masks=(8,), height=90, width=120, all_pairs=True, literal_masks=5, data=tmp_path / "none", out=out
    )
    record = extract.main(arguments)
    assert json.loads(out.read_text()) == record
    stages = {row["stage"]: row for row in record["rows"]}
    assert set(stages) == {"mask rule", "intersections: matrix product", "clean-up", "painting", "crops"}
    assert not any("DIFFERENT" in row["agreement"] for row in record["rows"])
    assert (stages["mask rule"]["measured_in_full"], stages["clean-up"]["measured_in_full"]) == (True, False)
    assert "masks from: soft noise" in capsys.readouterr().out
    with pytest.raises(OutputExistsError):
        extract.main(arguments)
    sampled = extract.main(
        extract.Arguments(masks=(8,), height=50, width=60, pairs=5, data=tmp_path / "none")
    )
    assert sampled["rows"][0]["agreement"] == "not compared"


@pytest.mark.slow
def test_kept_sums(script, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    kept = script("kept_sums")
    arguments = kept.Arguments(
        n_gaussians=200,
        views=2,
        width=40,
        height=30,
        regions=(6, 4, 2),
        kitchen=False,
        out=tmp_path / "k.json",
    )
    record = kept.main(arguments)
    assert json.loads((tmp_path / "k.json").read_text()) == record
    room = record["scenes"]["room"]
    assert room["sums"]["float16"]["bytes"] < room["sums"]["float32"]["bytes"]
    assert room["sums"]["float32"]["same_atoms"] == 1
    assert set(room["builds"]) == {*kept.CHANGES, "other embeddings"}
    assert "other embeddings" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore:.*badly explained")
@pytest.mark.parametrize("in_file", [False, True])
def test_stream(script, tmp_path: Path, capsys: pytest.CaptureFixture[str], in_file: bool):
    stream = script("stream")
    arguments = stream.Arguments(
        frames=3, windows=(2, 3), rounds=(1, 2), n_gaussians=300, regions=(6, 4, 2), in_file=in_file,
        out=tmp_path / "stream.json", **SMALL,
    )  # fmt: skip
    record = stream.main(arguments)
    assert json.loads((tmp_path / "stream.json").read_text()) == record
    assert [(row["rounds"], row["window"]) for row in record["rows"]] == [(1, 2), (1, 3), (2, 2), (2, 3)]
    for row in record["rows"]:
        assert 0 < row["vote_s"] < row["update_s"] <= row["worst_update_s"]
        assert 0 < row["buckets"] <= 1
        assert row["largest_sums"] > 0
    assert "views kept" in capsys.readouterr().out


@pytest.mark.slow
def test_scenes_that_fit_and_scenes_that_do_not(script, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    fit, cases = script("fit"), script("fit_cases")
    arguments = fit.Arguments(
        data=tmp_path / "none", layouts=("table", "yard"), seeds=(0,), n_gaussians=6000, width=64, views=9, cost=50,
        cost_views=2, out=tmp_path / "fit.json",
    )  # fmt: skip
    record = fit.main(arguments)
    assert json.loads((tmp_path / "fit.json").read_text()) == record
    assert len(record["rows"]) == 2 * len({**cases.RIGHT, **cases.WRONG})
    verdicts = {(row["scene"], row["case"]): row["verdict"] for row in record["rows"]}
    assert {verdicts[name, "as it is"] for name in ("table-0", "yard-0")} == {"fits"}
    assert verdicts["table-0", "splat of another scene"] == "hopeless"
    assert verdicts["yard-0", "photographs shuffled"] == "hopeless"
    assert record["cost"]["share"] == record["cost"]["check_s"] / record["cost"]["build_s"]
    assert "| photographs one off" in capsys.readouterr().out
    with pytest.raises(OutputExistsError):
        fit.main(arguments)


def test_two_checkouts_beside_each_other(script, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    beside = script("beside")
    run = beside.run
    runs = iter([{"total_s": 4.0}, {"total_s": 2.0}, {"total_s": 5.0}, {"total_s": 1.0}])
    roots = []
    monkeypatch.setattr(beside, "run", lambda root, *_: roots.append(root) or next(runs))
    arguments = beside.Arguments(tmp_path, "benchmarks.raster", figures=("total_s",), out=tmp_path / "b.json")
    record = beside.main(arguments, ["--threads", "2"])
    assert roots == [tmp_path, ROOT] * 2  # by turns
    assert record["figures"]["total_s"] == {"before": 4.0, "now": 1.0, "ratio": 0.25}
    with pytest.raises(InputError, match=r"no \.venv"):
        run(tmp_path, "benchmarks.raster", [])
