"""The benchmark of codes learned through renderings, tiny, from arguments to its file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.joint import Arguments, curve, main, published

from scoup.base.errors import InputError, OutputExistsError
from synthetic.small_scenes import one_light


@pytest.fixture(scope="module")
def arguments(tmp_path_factory: pytest.TempPathFactory) -> Arguments:
    return Arguments(
        n_gaussians=2000,
        views=3,
        labelled=1,
        width=64,
        iterations=(3, 1),
        training_width=32,
        methods=("sparse", "dense"),
        out=tmp_path_factory.mktemp("joint") / "joint.json",
    )


@pytest.mark.slow
def test_every_row_is_measured(arguments: Arguments, capsys: pytest.CaptureFixture[str]) -> None:
    with one_light():
        record = main(arguments)
    assert arguments.out is not None
    assert json.loads(arguments.out.read_text())["published"] == record["published"]
    rows = record["methods"]
    assert list(rows) == ["sparse", "dense", "joint-codes, 1 steps", "joint-codes, 3 steps"]
    for of in rows.values():
        assert 0 <= of["miou"] <= 1
        assert 0 <= of["localisation"] <= 1
        assert of["total_s"] == of["rasterise_s"] + of["fit_s"] > 0
        assert of["cpu_s"] > 0
    assert rows["dense"]["rasterise_s"] == rows["sparse"]["rasterise_s"] > 0
    last = rows["joint-codes, 3 steps"]
    assert last["steps"] == 9
    assert [point[0] for point in last["loss"][0]] == [1, 2, 3]
    assert last["rasterise_s"] == 0
    found = record["published"]
    assert found["from"] == "joint-codes, 3 steps"
    for kind in ("total_s", "cpu_s"):
        assert found[kind]["measured_times"]["sparse"] == last[kind] / rows["sparse"][kind]
    assert "extrapolated" in capsys.readouterr().out


def test_nothing_is_overwritten_and_no_steps_are_refused(arguments: Arguments, tmp_path: Path) -> None:
    taken = tmp_path / "joint.json"
    taken.write_text("{}")
    with pytest.raises(OutputExistsError):
        main(Arguments(out=taken))
    with pytest.raises(InputError, match="--iterations"):
        main(Arguments(iterations=(0, 5)))


def test_extrapolation() -> None:
    rows = {"a": {"total_s": 2.0, "cpu_s": 1.0}, "b": {"total_s": 12.0, "cpu_s": 3.0, "steps": 20}}
    found = published(rows, "b", 2)  # 20 of 20000 steps
    assert found["total_s"] == {"extrapolated": 12000.0, "times": {"a": 6000.0}, "measured_times": {"a": 6.0}}
    assert found["cpu_s"] == {"extrapolated": 3000.0, "times": {"a": 3000.0}, "measured_times": {"a": 3.0}}


def test_curves_are_means_between_points() -> None:
    assert curve([3.0, 1.0]) == [[1, 3.0], [2, 1.0]]
    points = curve([float(number) for number in range(40)])
    assert points[0] == [2, 0.5]
    assert points[-1] == [40, 38.5]
    assert len(points) == 20
