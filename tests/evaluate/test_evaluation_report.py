"""Tables: means, intervals, published rows beside ours only where they belong."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from scoup.base.errors import OutputExistsError
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

DATA_SET_OF = {each.title: name for name, each in PIXELS.items()} | {"3D selection": "lerf-ovs"}
PAIRS = {"figurines": 56, "teatime": 59, "ramen": 71, "waldo_kitchen": 22}  # of LERF-OVS


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
    assert [row[1].split()[0] for row in table.rows] == ["measured"] + ["published"] * len(
        PUBLISHED["lerf-ovs 2D"]
    )
    assert table.rows[1][:3] == ("SCOUP (paper)", "published [1]", "64.4")
    assert any("none was measured here" in note for note in table.notes)
    by_scene = published_table(report("ramen", "teatime"))
    assert by_scene.headers == ("system", "source", "ramen", "teatime")
    assert by_scene.rows[0] == ("this run", "measured", "50.0 / 33.3", "50.0 / 33.3")
    assert by_scene.rows[1] == ("SCOUP (paper)", "published [1]", "57.6 / 74.7", "75.3 / 91.5")
    table = overall_table(report("ramen", "table"))
    assert len(table.rows) == 1
    assert any("left out" in note for note in table.notes)
    assert report_record(report("table"))["published_percent"] == []


@pytest.mark.parametrize("protocol", PUBLISHED)
def test_each_published_row_has_a_footnote_that_says_where_it_is_from(protocol: str) -> None:
    scenes = PIXELS[DATA_SET_OF[protocol]].scenes
    of_scenes = [scene(name, {"cup": [0.5]}, protocol) for name in scenes]
    run = PixelScores(protocol, "scoup", tuple(of_scenes), scenes)
    table = overall_table(run)
    for row, published in zip(table.rows[1:], PUBLISHED[protocol], strict=True):
        number = row[1].removeprefix("published ")
        (note,) = (note for note in table.notes if note.startswith(number))
        for said in (
            published.origin.source,
            published.origin.by,
            published.origin.read_in,
            published.protocol,
        ):
            assert said in note
        assert f"published {number}" in table.markdown()
        assert f"published {number}" in table.latex()
    assert r"\par\footnotesize [1] SCOUP (arXiv 2605.13600)" in table.latex() or protocol == "3D selection"
    records = report_record(run)["published_percent"]
    assert [(each["system"], each["origin"]["source"], each["footnote"]) for each in records] == [
        (each.system, each.origin.source, each.note) for each in PUBLISHED[protocol]
    ]


def test_selection_on_another_data_set_shows_no_figures_of_lerf_ovs() -> None:
    room = PixelScores("3D selection", "vala-3d", (scene("room", {"cup": [0.5]}, "3D selection"),), ("room",))
    assert room.published == ()
    assert len(overall_table(room).rows) == 1


# Means over scenes that print otherwise: there the paper's overall figure is the mean over pairs.
BY_PAIRS = {("lerf-ovs 2D", "LangSplatV2")}


@pytest.mark.parametrize("protocol", PUBLISHED)
def test_published_figures_agree_with_themselves(protocol: str) -> None:
    """Each row has a source; means over scenes are the overall figures, as far as they are rounded."""
    scenes = set(PIXELS[DATA_SET_OF[protocol]].scenes)
    for row in PUBLISHED[protocol]:
        assert row.origin.source
        assert row.origin.read_in
        assert row.miou is not None or row.accuracy is not None
        if not row.by_scene:
            continue
        assert set(row.by_scene) == scenes
        for which, overall in enumerate((row.miou, row.accuracy)):
            found = {name: both[which] for name, both in row.by_scene.items()}
            figures = {name: figure for name, figure in found.items() if figure is not None}
            if not figures:
                continue
            assert set(figures) == scenes
            weights = PAIRS if which and (protocol, row.system) in BY_PAIRS else dict.fromkeys(scenes, 1)
            mean = sum(figures[name] * weights[name] for name in scenes) / sum(
                weights[name] for name in scenes
            )
            assert mean == pytest.approx(overall, abs=0.06), (protocol, row.system)


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
    assert table.markdown() == "## A & B\n\n| name | 50 % |\n|---|---:|\n| a\\|b | x_y |\n\n* note\n"
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


def test_published_rows_of_protocols_without_localisation() -> None:
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
