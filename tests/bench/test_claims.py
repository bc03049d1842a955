"""benchmarks.claims on tiny scenes: every figure is there, and says what it should."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

ROOT = Path(__file__).resolve().parents[2]
TINY = {"n_gaussians": 2500, "width": 48, "height": 36, "views": 4, "repeats": 1}


@pytest.fixture(autouse=True)
def _benchmarks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(ROOT))


@pytest.mark.slow
def test_every_part(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from benchmarks.claims import Arguments, main

    out = tmp_path / "claims.json"
    sizes = {"dims": (4, 8), "entropy_gaussians": 2500, "glass_things": 1}
    record = main(Arguments(**TINY, **sizes, out=out))
    assert json.loads(out.read_text())["uplift"] == json.loads(json.dumps(record["uplift"]))
    assert [row["dim"] for row in record["uplift"]["dense"]] == [4, 8]
    for row in record["uplift"]["dense"]:
        assert row["ratio"] == pytest.approx(row["dense_s"] / record["uplift"]["sparse_s"])
        parts = (record["uplift"][name] for name in ("rasterise_s", "matrices_s"))
        assert row["dense_s"] == pytest.approx(sum(parts) + row["products_s"])
        one_view = record["uplift"]["timings"][f"pixels {row['dim']}"]["median_s"]
        assert row["by_pixel_s"] == pytest.approx(one_view * 4 * 3)
    assert list(record["views"]) == ["colours", "codes, three levels", "8 numbers, three levels"]
    for row in record["views"].values():
        assert row["views_a_second"] == pytest.approx(1 / row["median_s"])
    assert len(record["entropy"]) == 6
    (row,) = record["glass"]
    assert set(row["before"]) == set(row["after"]) == {"miou", "accuracy", "others_miou", "others_accuracy"}
    assert row["thing"] in capsys.readouterr().out


def test_glass_changes_the_opacity_of_the_thing_alone() -> None:
    from benchmarks.claims_scenes import as_glass, members

    from scoup_lab.synthetic.scene import make_demo_scene

    demo = make_demo_scene(0, 2500, 48, 36, 2, 1)
    name = demo.parts.names("m")[0]
    chosen = members(demo, name)
    assert 0 < int(chosen.sum()) < 2500
    parts = demo.part_of_gaussian[chosen].unique().tolist()
    assert {demo.parts.objects[demo.parts.object_of_part[part]] for part in parts} == {name}
    changed = as_glass(demo.gaussians, chosen, 0.1)
    ratio = changed.opacities / demo.gaussians.opacities
    torch.testing.assert_close(ratio, torch.where(chosen, 0.1, 1.0))
    assert changed.means is demo.gaussians.means
