"""Tables: means, intervals, published rows beside ours only where they belong."""

from __future__ import annotations

import json
from pathlib import Path
from statistics import mean

import pytest

from scoup.base import OutputExistsError
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


def scene(name: str, ious: dict[str, list[float]], protocol: str = "lerf-ovs 2D") -> SceneScore:
    localizes = protocol == "lerf-ovs 2D"
    pairs = [
        PairScore(f"f{n}", label, value, value > 0.5 if localizes else None, n % 3, 0.7, (1, 2))
        for label, values in ious.items()
        for n, value in enumerate(values)
    ]
    return SceneScore(name, "scoup", tuple(pairs), protocol)


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


def test_selection_on_another_data_set_shows_no_figures_of_lerf_ovs() -> None:
    room = PixelScores("3D selection", "vala-3d", (scene("room", {"cup": [0.5]}, "3D selection"),), ("room",))
    assert room.published == ()
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
    records = query_records(scene("ramen", {"pot": [0.9], "cup": [0.2, 0.4]}))
    assert [record["query"] for record in records] == ["cup", "pot"]
    assert records[0]["miou"] == pytest.approx(0.3)
    assert records[0]["accuracy"] == 0
    assert records[0]["levels"] == [(0, 1), (1, 1)]
    table = query_table(report("ramen"), ("s", "m", "l"))
    assert table.rows[0] == ("cup", "ramen", "2", "30.0", "0.0", "s1 m1")


def test_markdown_and_latex() -> None:
    table = Table("A & B", ("name", "50 %"), (("a|b", "x_y"),), ("note",))
    rows = "| name | 50 % |\n| ---- | ---: |\n| a\\|b |  x_y |\n"
    assert table.markdown() == f"## A & B\n\n{rows}\n* note\n"
    latex = table.latex()
    assert r"\caption{A \& B}" in latex
    assert r"name & 50 \% \\" in latex
    assert r"x\_y" in latex
    assert r"\begin{tabular}{lr}" in latex


def test_protocols_without_localisation_have_no_such_columns() -> None:
    table = overall_table(report("room", protocol="3d-ovs 2D"))
    assert table.headers == ("system", "source", "mIoU", "95 % interval")
    record = report_record(report("room", protocol="3d-ovs 2D"))
    assert record["overall"]["accuracy"] is None
    table = published_table(report("sofa", protocol="3d-ovs 2D"))
    assert table.rows[0] == ("this run", "measured", "50.0")


def test_files(tmp_path: Path) -> None:
    found = report("ramen").report("r", ("s", "m", "l"))
    found.write(tmp_path / "out")
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["r.json", "r.md", "r.tex"]
    read = json.loads((tmp_path / "out" / "r.json").read_text())
    assert read == json.loads(json.dumps(found.record))
    assert read["overall"]["miou"] == pytest.approx(0.5)
    assert len(read["scenes"]["ramen"]["pairs"]) == 3
    with pytest.raises(OutputExistsError):
        found.write(tmp_path / "out")
