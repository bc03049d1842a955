"""Scores by hand, the bootstrap by its properties, and tables: published rows beside ours only where they belong."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import mean

import pytest
import torch

from messages import refuses
from scoup.base import OutputExistsError
from scoup_lab.evaluate.metrics import Interval, any_inside, bootstrap_interval, iou
from scoup_lab.evaluate.pixel_report import (
    PixelScores,
    overall_table,
    published_table,
    query_records,
    query_table,
    report_record,
)
from scoup_lab.evaluate.protocols import PIXELS
from scoup_lab.evaluate.published import PUBLISHED
from scoup_lab.evaluate.scores import PairScore, SceneScore, accuracy_interval, miou_interval
from scoup_lab.evaluate.tables import Table


def test_iou() -> None:
    first = torch.tensor([[True, True, False], [False, False, False]])
    second = torch.tensor([[False, True, True], [False, False, False]])
    assert iou(first, second) == pytest.approx(1 / 3)
    assert iou(first, first) == 1
    assert iou(first, ~first) == 0
    assert iou(torch.zeros(2, 2, dtype=torch.bool), torch.zeros(2, 2, dtype=torch.bool)) == 1
    with refuses():
        iou(first, second.T)


def test_points_on_borders_are_inside() -> None:
    boxes = torch.tensor([[10.0, 20.0, 30.0, 40.0], [50.5, 50.5, 51.5, 51.5]])
    for x, y, expected in ((10, 20, True), (30, 40, True), (9, 20, False), (30, 41, False), (51, 51, True)):
        assert any_inside(torch.tensor([[x, y]]), boxes) is expected
    assert any_inside(torch.tensor([[0, 0], [51, 51]]), boxes)
    assert not any_inside(torch.zeros(0, 2, dtype=torch.long), boxes)


def test_bootstrap() -> None:
    values = [0.0, 1.0] * 50
    many = bootstrap_interval(values, [str(index) for index in range(100)])
    assert many.mean == 0.5
    assert 0.37 < many.low < 0.45 < 0.55 < many.high < 0.63
    assert bootstrap_interval(values, [str(index) for index in range(100)]) == many
    # Values of one query stand and fall together: fewer independent draws, a wider interval.
    few = bootstrap_interval([0.0] * 50 + [1.0] * 50, [str(index // 10) for index in range(100)])
    assert few.high - few.low > many.high - many.low
    assert bootstrap_interval([0.3, 0.3], ["a", "b"]).low == pytest.approx(0.3)
    assert bootstrap_interval([0.5], ["a"]) == Interval(0.5, 0.5, 0.5)
    for wrong in (([], []), ([1.0], []), ([float("nan")], ["a"])):
        with refuses():
            bootstrap_interval(*wrong)


def test_each_scene_counts_alike() -> None:
    values, groups = [1.0, 0.0, 0.0, 0.0], ["cup", "cup", "pot", "fork"]
    whole = bootstrap_interval(values, groups)
    assert whole == bootstrap_interval(values, groups, scenes=["a"] * 4)
    assert whole.mean == 0.25
    # A scene of one value and a scene of three; neither can be drawn away.
    apart = bootstrap_interval(values, groups, scenes=["a", "b", "b", "b"])
    assert apart.mean == 0.5
    assert (apart.low, apart.high) == (0.5, 0.5)
    with refuses():
        bootstrap_interval(values, groups, scenes=["a"])


def scene(name: str, ious: dict[str, list[float]], protocol: str = "lerf-ovs 2D") -> SceneScore:
    localizes = protocol == "lerf-ovs 2D"
    pairs = tuple(
        PairScore(f"f{n}", label, value, value > 0.5 if localizes else None, n % 3, 0.7, (1, 2))
        for label, values in ious.items()
        for n, value in enumerate(values)
    )
    return SceneScore(name, "scoup", pairs, protocol)


def report(*names: str, protocol: str = "lerf-ovs 2D") -> PixelScores:
    scenes = [scene(name, {"cup": [0.2, 0.4], "pot": [0.9]}, protocol) for name in names]
    return PixelScores(protocol, "scoup", tuple(scenes), ("ramen", "teatime", "waldo_kitchen", "figurines"))


def test_every_scene_counts_alike() -> None:
    scenes = [scene("ramen", {"cup": [1.0]}), scene("teatime", {"cup": [0.0] * 9})]
    assert miou_interval(scenes).mean == pytest.approx(0.5)
    found = accuracy_interval(scenes)
    assert found is not None
    assert found.mean == pytest.approx(0.5)
    assert accuracy_interval([scene("room", {"cup": [1.0]}, "3d-ovs 2D")]) is None


def test_published_rows_stand_beside_published_scenes_only() -> None:
    table = overall_table(report("ramen", "teatime"))
    assert [row[1] for row in table.rows] == ["measured"] + ["published"] * len(PUBLISHED["lerf-ovs 2D"])
    assert table.rows[1][:3] == ("SCOUP (paper)", "published", "64.4")
    assert any("arXiv 2605.13600" in note and "none was measured here" in note for note in table.notes)
    by_scene = published_table(report("ramen", "teatime"))
    assert by_scene.headers == ("system", "source", "ramen", "teatime")
    assert by_scene.rows[0] == ("this run", "measured", "50.0 / 33.3", "50.0 / 33.3")
    assert by_scene.rows[1] == ("SCOUP (paper)", "published", "57.6 / 74.7", "75.3 / 91.5")
    table = overall_table(report("ramen", "table"))
    assert len(table.rows) == 1
    assert any("left out" in note for note in table.notes)
    assert report_record(report("table"))["published_percent"] == []
    room = PixelScores("3D selection", "vala-3d", (scene("room", {"cup": [0.5]}, "3D selection"),), ("room",))
    assert not room.published  # of another data set than LERF-OVS
    assert len(overall_table(room).rows) == 1


@pytest.mark.parametrize("protocol", PUBLISHED)
def test_published_figures_agree_with_themselves(protocol: str) -> None:
    """Means over scenes are the overall figures, as far as they are rounded."""
    scenes = set(PIXELS[protocol.removesuffix(" 2D")].scenes)
    row = PUBLISHED[protocol][0]
    assert row.by_scene is not None
    assert set(row.by_scene) == scenes
    assert mean(both[0] for both in row.by_scene.values()) == pytest.approx(row.miou, abs=0.06)
    accuracies = [both[1] for both in row.by_scene.values() if both[1] is not None]
    assert len(accuracies) == (len(scenes) if row.accuracy is not None else 0)
    if row.accuracy is not None:
        assert mean(accuracies) == pytest.approx(row.accuracy, abs=0.06)


def test_queries_worst_first() -> None:
    worst, best = query_records(scene("ramen", {"pot": [0.9], "cup": [0.2, 0.4]}))
    assert (worst["query"], best["query"]) == ("cup", "pot")
    assert (worst["miou"], worst["accuracy"]) == (pytest.approx(0.3), 0)
    assert worst["levels"] == [(0, 1), (1, 1)]
    table = query_table(report("ramen"), ("s", "m", "l"))
    assert table.rows[0] == ("cup", "ramen", "2", "30.0", "0.0", "s1 m1")


def test_markdown_and_latex() -> None:
    table = Table("A & B", ("name", "50 %"), (("a|b", "x_y"),), ("note",))
    rows = "| name | 50 % |\n| ---- | ---: |\n| a\\|b |  x_y |\n"
    assert table.markdown() == f"## A & B\n\n{rows}\n* note\n"
    for part in (r"\caption{A \& B}", r"name & 50 \% \\", r"x\_y", r"\begin{tabular}{lr}"):
        assert part in table.latex()


def test_protocols_without_localisation_have_no_such_columns() -> None:
    found = report("sofa", protocol="3d-ovs 2D")
    assert overall_table(found).headers == ("system", "source", "mIoU", "95 % interval")
    assert report_record(found)["overall"]["accuracy"] is None
    assert published_table(found).rows[0] == ("this run", "measured", "50.0")


def test_files(tmp_path: Path) -> None:
    found = report("ramen").report("r", ("s", "m", "l"))
    found.write(tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["r.json", "r.md", "r.tex"]
    read = json.loads((tmp_path / "out" / "r.json").read_text())
    assert read == json.loads(json.dumps(found.record))
    assert (read["overall"]["miou"], len(read["scenes"]["ramen"]["pairs"])) == (pytest.approx(0.5), 3)
    with pytest.raises(OutputExistsError):
        found.write(tmp_path / "out")
