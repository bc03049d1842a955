"""The benchmark of positions and boxes, tiny, from arguments to its file."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from benchmarks.locate import box_overlap, main

from synthetic.small_scenes import one_light


@pytest.mark.slow
def test_every_row_is_measured(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with one_light():
        main(("table-0",), 4000, tmp_path / "locate.json")
    rows = {row["what"]: row for row in json.loads((tmp_path / "locate.json").read_text())["rows"]}
    assert len(rows) == 5
    assert len(capsys.readouterr().out.splitlines()) == 6
    assert 0 < rows["strays left off"]["iou"] < 1
    assert rows["strays left off"]["median_error"] < 0.25
    assert rows["box of one part"]["stretched"] <= rows["box of the mask"]["stretched"]


def test_boxes_overlap() -> None:
    assert box_overlap((0, 0, 4, 4), (0, 0, 4, 4)) == 1
    assert box_overlap((0, 0, 4, 4), (2, 0, 6, 4)) == pytest.approx(1 / 3)
    assert box_overlap((0, 0, 4, 4), (4, 4, 6, 6)) == 0
