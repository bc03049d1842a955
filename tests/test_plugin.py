"""The example of a package that extends the tables: installed, and used by name."""

from __future__ import annotations

import os
import shutil
import sys
import zipfile
from pathlib import Path

import pytest

from children import finished
from cli_support import write_scene

PLUGIN = Path(__file__).resolve().parents[1] / "examples" / "plugin"
PROGRAM = """
import torch
import scoup
from cli_support import run, run_json
from scoup_lab.baselines.methods import METHODS
from scoup_lab.baselines.rasterised_scene import RasterisedScene
from support import small_scene

rows = {row["name"]: row for table in run_json("extract", "--list").values() for row in table}
assert rows["grid"]["what it is"] == "square cells" and rows["grid"]["licence"] == "Apache-2.0"
record = run_json("extract", "scene", "--segmenter", "grid", "--embedder", "mean-colour", "--out", "regions")
assert (record["made"], record["embedding_model"]) == (4, "mean-colour")
red, other = scoup.TextEncoder.open("mean-colour").encode(["red", "sadness"])
torch.testing.assert_close(red, torch.tensor([1.0, 0, 0]))
torch.testing.assert_close(other, torch.full((3,), 3**-0.5))
run_json("convert", "scene/point_cloud.ply", "a.csv")
before, after = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_gaussians("a.csv")
torch.testing.assert_close(after.means, before.means)
torch.testing.assert_close(after.opacities, before.opacities)
assert run_json("info", "a.csv")["kind"] == "splat"
assert ".csv" in run("info", "words.npz.bak")[2]

size = ("--n-gaussians", 2000, "--width", 64, "--height", 48, "--views", 2, "--labelled", 1, "--scenes", 1)
run_json("eval", "synthetic", "lerf-ovs", "data", *size)
methods = ("--methods", "heaviest-region", "--methods", "centre-pixel")
scores = run_json("eval", "baselines", "data", *methods)["methods"]
assert list(scores) == ["heaviest-region", "centre-pixel"]
inputs = RasterisedScene(*small_scene(count=60, views=2)).inputs()
fitted = METHODS["heaviest-region"].uplift(inputs, None)
for level, features in enumerate(fitted.channels):
    sums = inputs.sums.matrix(level).toarray()
    for row, given in zip(sums, features):
        expected = inputs.embeddings[level][row.argmax()] if row.any() else torch.zeros(16)
        assert given.equal(expected)
"""


@pytest.mark.usefixtures("quick_python")
def test_a_package_is_used_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    backend = pytest.importorskip("hatchling.build", reason="hatchling is not installed")
    monkeypatch.chdir(shutil.copytree(PLUGIN, tmp_path / "source"))
    with zipfile.ZipFile(tmp_path / backend.build_wheel(tmp_path)) as wheel:
        wheel.extractall(tmp_path / "site")
    write_scene(tmp_path / "scene")
    (tmp_path / "words.npz.bak").touch()
    places = os.pathsep.join(map(str, [tmp_path / "site", *Path(__file__).parents[:2]]))
    environment = {**os.environ, "PYTHONPATH": places, "OMP_NUM_THREADS": "1"}
    finished([sys.executable, "-c", PROGRAM], check=True, cwd=tmp_path, env=environment)
