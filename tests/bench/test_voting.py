"""benchmarks/voting.py on a tiny scene: results on disk, what is run again and what is not, the table."""

from __future__ import annotations

import functools
import importlib
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from scoup import raster
from scoup.base.errors import InputError, UnknownNameError
from scoup.baselines.method import DEFAULTS, Method
from scoup.baselines.rasterised_scene import UpliftInputs
from scoup.baselines.sparse import SparseUplift
from scoup.evaluate.metrics import bootstrap_interval
from scoup.evaluate.protocols.lerf_ovs import score_frame
from scoup.field.relevancy import relevancy
from scoup.query.presets import QUERY_PRESETS
from scoup.synthetic.faults import as_region_sums
from scoup.uplift.build_settings import BUILD_PRESETS, BuildSettings

PARTS = ("_scenes", "_ways", "_scores", "_results")
ROOT = Path(__file__).resolve().parents[2]
WAYS = ("dense", "paper", "paper-no-top-k", "exact", "exact-mask", "default")


@pytest.fixture(scope="module")
def voting():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOT))
        modules = {name: importlib.import_module(f"benchmarks.voting{name}") for name in ("", *PARTS)}
        # The scene is the same for all tests, and takes longer to make than to be asked.
        patch.setattr(modules[""], "make_scene", functools.cache(modules["_scenes"].make_scene))
        yield lambda name="": modules[name]


def tiny(voting, rows: Path, **changes: Any):
    size = voting("_scenes").SceneSize(2500, 64, 48, n_building=4, n_held_out=2)
    given = {"scenes": ("table-0",), "cases": ("wrong20+rare",), "ways": WAYS, "seeds": (0,)}
    return voting().Arguments(**{**given, "epochs": 3, "rows": rows, "size": size, **changes})


def effective(method: Method) -> BuildSettings:
    """The settings of the build by which a sparse method is fitted."""
    assert isinstance(method.uplift, SparseUplift)
    return replace(DEFAULTS.build, **method.uplift.changes)


def inputs_of(scene) -> UpliftInputs:
    """What methods are fitted to, without faults."""
    return UpliftInputs(as_region_sums(scene.levels), [level.embeddings for level in scene.levels])


def test_from_arguments_to_the_table(voting, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "voting.json"
    cases = ("clean", "wrong20+rare")
    first = voting().main(tiny(voting, out, cases=cases, ways=("dense", "dense-mask")))
    lines = capsys.readouterr().out.splitlines()
    assert "| difference | clean | wrong20+rare | all cases |" in lines
    assert [line.split(" | ")[0] for line in lines if "[" in line and "|" in line] == ["| mask - peak, dense"]
    kept = json.loads(out.read_text())
    assert kept == first.content

    results = voting().main(tiny(voting, out))
    assert json.loads(out.read_text()) == results.content
    # What was there was not run again: its seconds are the same, too.
    for case in cases:
        of_scene = results.content["scenes"]["table-0"]["cases"]
        assert of_scene[case]["dense"] == kept["scenes"]["table-0"]["cases"][case]["dense"]
    printed = capsys.readouterr().out
    assert not any("table-0    wrong20+rare     dense" in line for line in printed.splitlines())
    rows = [line for line in printed.splitlines() if line.startswith("| ")]
    for name in (*WAYS, "exact - paper", "top-K - no top-K, paper", "mask - peak, exact", "default - dense"):
        assert any(row.startswith(f"| {name} |") for row in rows), name
    # Nothing is left to do; the table is the same.
    before = out.read_bytes()
    again = voting().main(tiny(voting, out))
    assert capsys.readouterr().out.strip() == printed[printed.rindex("mIoU / loc") :].strip()
    assert (out.read_bytes(), again.content) == (before, results.content)

    find_way, compare = voting("_ways").find_way, voting("_results").compare
    ways = [find_way(name) for name in ("exact-mask", "exact")]
    entry = results.get("table-0", "wrong20+rare", ways[0].method.name)
    assert entry.bytes_per_gaussian == 36
    assert entry.mask_by_seed == pytest.approx([sum(entry.mask) / len(entry.mask)], abs=1e-4)
    differences = [a - b for a, b in zip(entry.mask, entry.peak, strict=True)]
    labels = [label for _, label in results.pairs("table-0")]
    assert compare(results, ["table-0"], ["wrong20+rare"], *ways) == bootstrap_interval(differences, labels)
    assert compare(results, ["table-0"], ["clean"], *ways) is None


def test_scores_are_those_of_the_protocol(voting, tmp_path: Path) -> None:
    ways, scores = voting("_ways"), voting("_scores")
    arguments = tiny(voting, tmp_path / "voting.json")
    scene = voting().make_scene("table-0", arguments.data, arguments.size)
    fitted = ways.WAYS["exact"].method.uplift(inputs_of(scene), DEFAULTS)
    indices, weights = fitted.field.code_indices, fitted.field.code_weights
    codebook = fitted.field.codebook
    found = scores.score(scene, fitted)
    for choice, values in (("peak", found.peak), ("mask", found.mask)):
        preset = replace(QUERY_PRESETS["scoup"], level_choice=choice)
        expected = []
        for frame, view in scene.frames:
            queries = torch.stack([scene.queries[label] for label in frame.labels])
            cosines = raster.render_cosines(
                view, indices, weights, codebook, torch.cat([queries, scene.canonical])
            )
            maps = relevancy(cosines[:, : len(queries)], cosines[:, len(queries) :])
            expected += score_frame(frame, maps, preset)
        assert values == [pair.iou for pair in expected]
        assert found.hit == [pair.hit for pair in expected]
        assert scene.pairs == [(pair.frame, pair.label) for pair in expected]
    assert all(best >= max(both) for best, *both in zip(found.best, found.peak, found.mask, strict=True))


def test_seeds_are_averaged_pair_by_pair(voting) -> None:
    scores = voting("_scores").Scores
    first = scores([0.5, 1.0], [0.25, 0.5], [0.5, 1.0], [1.0, 1.0])
    second = scores([0.0, 0.5], [0.75, 1.0], [0.75, 1.0], [0.0, 1.0])
    entry = voting("_results").Entry.of([first, second], [3, 4], 36.0, 1.25)
    assert (entry.peak, entry.mask, entry.best) == ([0.25, 0.75], [0.5, 0.75], [0.625, 1.0])
    assert (entry.hit, entry.seeds) == ([0.5, 1.0], [3, 4])
    assert (entry.peak_by_seed, entry.mask_by_seed) == ([0.75, 0.25], [0.375, 0.875])


def test_what_cannot_be(voting, tmp_path: Path) -> None:
    out = tmp_path / "voting.json"
    out.write_text(json.dumps({"version": voting("_results").VERSION, "settings": {"draw": 9}, "scenes": {}}))
    with pytest.raises(InputError, match="another --rows"):
        voting().main(tiny(voting, out))
    with pytest.raises(UnknownNameError, match="exact"):
        voting("_ways").find_way("exakt")


def test_every_comparison_is_of_known_ways(voting) -> None:
    ways = voting("_ways")
    assert {name for pair in ways.COMPARISONS.values() for name in pair} <= set(ways.WAYS)
    methods = {way.method for way in ways.WAYS.values()}
    assert len({method.name for method in methods}) == len(methods)
    # No two methods do the same, but for the default and the one that is named after what it does today.
    builds = [effective(m) for m in methods if isinstance(m.uplift, SparseUplift)]
    assert len(builds) == len(methods) - len({"dense"})
    doubled = {build for build in builds if builds.count(build) > 1}
    assert doubled <= {BUILD_PRESETS["default"]}
    assert len(builds) - len(set(builds)) <= 1


def test_ways_are_what_their_names_say(voting) -> None:
    builds = {
        name: effective(way.method)
        for name, way in voting("_ways").WAYS.items()
        if isinstance(way.method.uplift, SparseUplift)
    }
    del builds["default"]
    for name, build in builds.items():
        assert name.endswith("-mask") == (voting("_ways").WAYS[name].level_choice == "mask")
        assert build.solver == ("adam" if name.startswith("paper") else "exact")
        assert build.n_atoms == next((size for size in (32, 128, 256) if f"-{size}" in name), 64)
        assert build.rounds == (3 if "rounds-3" in name else 2 if "rounds" in name else 1)
        assert build.k == next((k for k in (1, 2, 8) if f"-k{k}" in name), 4)
        assert not build.wide
        assert build.keep == (0 if "no-top-k" in name else 4 if "keep-4" in name else build.k)


def test_the_default_way_is_what_build_and_query_do(voting, tmp_path: Path) -> None:
    ways = voting("_ways")
    default, paper = ways.WAYS["default"], ways.WAYS["paper"]
    assert default.level_choice == "mask"
    assert effective(default.method) == BUILD_PRESETS["default"]
    assert effective(paper.method) == BUILD_PRESETS["paper"]
    assert effective(paper.method) == BuildSettings(64, 4, False, 4, 1, "adam", epochs=4000)
    assert paper.level_choice == "peak"
    arguments = tiny(voting, tmp_path / "voting.json")
    scene = voting().make_scene("table-0", arguments.data, arguments.size)
    inputs = inputs_of(scene)
    for keep, size in ((0, 1800), (4, 48)):
        uplift = SparseUplift(n_atoms=300, keep=keep, solver="adam", epochs=3)
        assert uplift(inputs, DEFAULTS).bytes_per_gaussian == size
