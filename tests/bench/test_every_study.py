"""Every study, tiny, from its options to a record that its table can be made of."""

from __future__ import annotations

import json
from typing import Any

import pytest
import torch
from benchmarks import locate
from benchmarks.answer_presence import auc, presence_of_group
from benchmarks.answer_scenes import SceneSize
from benchmarks.claims import Claims
from benchmarks.claims_scenes import as_glass, desk_rows, marked_members, members, study_scene
from benchmarks.coding import GRAM, PAPER_EPOCHS, PLAIN, Coding
from benchmarks.documents import STUDIES, record
from benchmarks.lerf_sized import LerfSized
from benchmarks.query import STAGES, Query
from benchmarks.scenes import scene_of
from benchmarks.study import Record, Study, run
from benchmarks.things import PAIRS, Things
from benchmarks.true_counts import true_counts

from scoup.coding.exact import EFFORTS
from scoup_lab.bench import usable_backends
from scoup_lab.synthetic.scene import make_demo_scene

SMALL: dict[str, Any] = {"width": 30, "height": 20}
OF_SCENES: dict[str, Any] = {"scenes": ("table-0",), "size": SceneSize(4000, 160, 120, 6, 2)}


def ran(study: Study) -> Record:
    """The record of a study, as JSON has it; its table can be made."""
    found = run(study, "test")
    assert json.loads(json.dumps(found)) == found
    return found


@pytest.mark.parametrize("name", STUDIES)
def test_tables_are_made_of_the_records_that_are_kept(name: str) -> None:
    study, of_record = STUDIES[name]
    assert study.table(record(of_record)).startswith(("|", "1"))


@pytest.mark.parametrize("backend", usable_backends()[0])
def test_a_whole_build(backend: str) -> None:
    found = ran(LerfSized(n_gaussians=80, views=3, regions=(6, 4, 2), preset="paper", epochs=3, n_atoms=8,
                          backend=backend, threads=1, **SMALL))  # fmt: skip
    assert {"coding s", "coding m", "coding l", "region sums", "after vote"} <= set(found["seconds"])
    assert sum(found["seconds"].values()) == pytest.approx(found["total_s"], abs=0.1)
    assert found["coded_gaussians"] > 0


@pytest.mark.usefixtures("quick_python")
def test_what_it_costs_to_ask() -> None:
    least = ran(Query(n_gaussians=200, n_atoms=8, repeats=2, verb_repeats=1, **SMALL))["least"]
    assert set(least) == set(STAGES)
    assert least["query, new camera"] > least["project"]


@pytest.mark.slow
def test_every_form_of_coding() -> None:
    found = ran(Coding(regions=(90, 150), repeats=2, dim=24, n_atoms=8, k=3, adam_epochs=20, adam_up_to=100))
    small, large = found["sizes"]
    assert (small["adam"]["epochs"], "adam" in large) == (20, False)
    for size in found["sizes"]:
        assert set(size["exact"]) == set(EFFORTS)
        assert set(size["epoch_s"]) == {GRAM, PLAIN}
        epochs = PAPER_EPOCHS * size["epoch_s"][PLAIN]["median"]
        assert size["whole_adam_s"][PLAIN] == pytest.approx(size["kmeans_s"] + epochs)
        steps = 100 * -(-size["regions"] // 64)
        assert size["autoencoder"]["all_epochs_s"] == pytest.approx(
            steps * size["autoencoder"]["step_s"]["median"]
        )
    assert small["exact"]["best"]["loss"] < small["adam"]["loss"]


@pytest.mark.slow
def test_claims() -> None:
    found = ran(Claims(n_gaussians=2500, width=48, height=36, views=4, repeats=1, dims=(4, 8),
                       entropy_gaussians=2500, glass_things=1))  # fmt: skip
    uplift = found["uplift"]
    median = {name: timing["median_s"] for name, timing in uplift["timings"].items()}
    for row in uplift["dense"]:
        parts = median["rasterise"] + median["matrices"] + median[f"dense {row['dim']}"]
        assert row["dense_s"] == pytest.approx(parts)
        assert row["ratio"] == pytest.approx(row["dense_s"] / uplift["sparse_s"])
        assert row["by_pixel_s"] == pytest.approx(median[f"pixels {row['dim']}"] * 4 * 3)
    assert list(found["views"]) == ["colours", "codes, three levels", "8 numbers, three levels"]
    assert len(found["entropy"]) == 5
    (row,) = found["glass"]
    assert set(row["before"]) == set(row["after"]) == {"miou", "accuracy", "others_miou", "others_accuracy"}


@pytest.mark.slow
def test_claims_of_a_marked_scene() -> None:
    demo = make_demo_scene(0, 2500, 48, 36, 4, 1)
    found = desk_rows(study_scene(demo, demo.gaussians), 1, 0)
    assert {row["group"] for row in found["settings"].values()} == {"vote", "atoms", "non-zeros", "entropy"}
    assert found["settings"]["L=32"]["seeds"] == [0, 1, 2]
    rows = found["features"]["results"]
    assert {row["features"] for row in rows} == {"raw", "autoencoder", "sparse codes"}
    assert len(found["glass"]) == 1
    assert "mIoU on desk: K=8" in Claims.table({"desk": found})


def test_marked_gaussians_are_those_of_the_thing() -> None:
    demo = make_demo_scene(0, 6000, 96, 72, 5, 3)
    scene = study_scene(demo, demo.gaussians)
    marked, true = marked_members(scene, "teddy bear"), members(demo, "teddy bear")
    assert int((marked & true).sum()) > 0.9 * max(int(marked.sum()), int(true.sum()))


def test_glass_changes_the_opacity_of_the_thing_alone() -> None:
    demo = make_demo_scene(0, 2500, 48, 36, 2, 1)
    name = demo.parts.names("m")[0]
    chosen = members(demo, name)
    assert 0 < int(chosen.sum()) < 2500
    parts = demo.part_of_gaussian[chosen].unique().tolist()
    assert {demo.parts.objects[demo.parts.object_of_part[part]] for part in parts} == {name}
    changed = as_glass(demo.gaussians, chosen)
    ratio = changed.opacities / demo.gaussians.opacities
    torch.testing.assert_close(ratio, torch.where(chosen, 0.1, 1.0))
    assert changed.means is demo.gaussians.means


@pytest.mark.slow
def test_things_and_relations() -> None:
    (row,) = ran(Things(scenes=("table-0",), n_gaussians=6000, most=2, desk=False))["rows"]
    assert 0 < row["iou"] <= 1
    assert row["ap"]["0.25"] >= row["ap"]["0.5"] >= row["ap"]["0.75"]
    assert sum(row["counts"]["one"][1:] + row["counts"]["several"][1:]) >= row["objects"] > 20
    assert set(row["relations"]) == {*PAIRS, "between"}
    assert row["relations"]["left of"][0] == 2
    assert row["bytes"][0] > row["bytes"][1] == 6  # three levels, two bytes each


def test_the_area_under_the_curve_counts_ties_half() -> None:
    tensor = torch.tensor([1.0, 2.0]).numpy()
    assert auc(tensor, tensor) == 0.5
    assert auc(tensor + 1, tensor) == 0.875


def test_presence_by_thresholds_chosen_on_the_other_scenes() -> None:
    one = {"present": [0.9, 0.8], "absent": [0.1, 0.5]}
    other = {"present": [0.45] * 4, "absent": [0.3]}
    found = presence_of_group({"desk": one, "table-real": other, "table-real-all": other})
    assert found["thresholds"] == {"desk": 0.45, "table-real": 0.805, "table-real-all": 0.805}
    assert found["chosen elsewhere"] == [pytest.approx(1 / 3, abs=1e-4), pytest.approx(2.5 / 3, abs=1e-4)]
    assert found["from"]["0.37"] == [1.0, pytest.approx(2.5 / 3, abs=1e-4)]


def test_visible_instances_are_counted() -> None:
    cameras = scene_of("table-0", 4000, 160, 120, 6, 2).building
    meanings = {"either": ["teapot", "table"], "nothing": ["no such name"]}
    assert true_counts("table", cameras.scaled(4), meanings) == {"either": 2, "nothing": 0}
    assert true_counts("table", cameras.scaled(0.05), meanings)["either"] == 0


@pytest.mark.slow
def test_positions_and_boxes() -> None:
    in_space, in_views = ran(locate.Locate(scenes=("table-0",), n_gaussians=4000))["rows"]
    assert 0 < in_space["iou"] < 1
    assert in_space["median_error"] < 0.25
    assert 0 < in_views["iou"] < 1


def test_boxes_overlap() -> None:
    assert locate.box_overlap((0, 0, 4, 4), (0, 0, 4, 4)) == 1
    assert locate.box_overlap((0, 0, 4, 4), (2, 0, 6, 4)) == pytest.approx(1 / 3)
    assert locate.box_overlap((0, 0, 4, 4), (4, 4, 6, 6)) == 0
