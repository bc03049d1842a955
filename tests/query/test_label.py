"""Labels of Gaussians, against a plain reading of the rule, and as files and maps of views."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

from gltf_samples import features_of
from messages import refuses
from query.conftest import ASKED, Queried
from scoup import raster
from scoup.base import UnknownNameError
from scoup.io import PlyTable
from scoup.io.splats.gltf import read_gltf
from scoup.io.splats.ply import read_ply
from scoup.pictures import label_colors
from scoup.query.answer import Answer
from scoup.query.ask import each_answer
from scoup.query.boxes import PointSets
from scoup.query.labels import (
    AT_A_TIME,
    NONE,
    GaussianLabels,
    LabelFiles,
    label_map,
    labelled_colors,
    labels_of_answers,
)
from scoup.query.language_field import LanguageField
from scoup.scene import SH_C0, estimate_up
from support import examples

LEVELS = ("s", "m", "l")


@settings(max_examples=examples(100))
@given(
    st.lists(st.tuples(st.sampled_from(LEVELS), st.sampled_from([None, 0.0, 0.4, 0.9])), min_size=1, max_size=6),
    st.floats(0, 1),
    st.integers(0, 2**31),
)  # fmt: skip
def test_of_words_for_one_gaussian_the_finest_level_counts_then_the_score(
    words: list[tuple[str, float | None]], share: float, seed: int
) -> None:
    masks = torch.rand(len(words), 20, generator=torch.Generator().manual_seed(seed)) < share
    answers = [
        Answer(str(number), mask, level, score, ASKED)
        for number, ((level, score), mask) in enumerate(zip(words, masks, strict=True))
    ]
    found = labels_of_answers(answers, LEVELS)
    for row in range(20):
        fitting = [number for number in range(len(words)) if masks[number, row]]
        finest = [n for n in fitting if words[n][0] == min((words[k][0] for k in fitting), key=LEVELS.index)]
        best = max(finest, key=lambda n: words[n][1] or 0.0, default=NONE)  # the first of equals
        assert int(found[row]) == best


def test_labels_are_the_answers(queried: Queried, voted: Queried) -> None:
    for asked in (queried, voted):
        for question in (asked.texts, replace(asked.texts, threshold=0.3)):
            answers, found = list(each_answer(asked.field, question)), asked.field.label(question)
            assert [each.to_dict() for each in found.answers] == [each.to_dict() for each in answers]
            counts = found.counts()
            assert sum(counts.values()) == len(asked.field)
            for number, name in enumerate(found.names):
                mine = found.ids == number
                assert counts[name] == int(found.mask(name).sum()) == int(mine.sum())
                assert set(found.instances[mine].tolist()) <= set(found.answers[number].things or [NONE])
            assert found.mask("none").equal(found.ids == NONE)
    with refuses(UnknownNameError):
        found.mask("word one")


def test_words_for_absent_things_label_nothing(queried: Queried, voted: Queried) -> None:
    for asked in (queried, voted):
        field, texts = asked.field, asked.texts
        bound = sorted(answer.score or 0 for answer in list(each_answer(field, texts)))[6]
        judged = field.label(replace(texts, present_from=bound))
        present = [number for number, there in enumerate(judged.answers) if there.presence]
        assert 0 < len(present) < len(judged.names)
        kept = replace(texts, texts=tuple(texts.texts[n] for n in present), queries=texts.queries[present])
        expected = torch.tensor([*present, NONE])[field.label(kept).ids.long()]
        assert judged.ids.equal(expected.int())
        assert not any(judged.answers[n].things for n in range(len(judged.names)) if n not in present)


def test_words_differ_from_each_other_and_from_none(queried: Queried) -> None:
    once = queried.texts.one(1)
    twice = replace(once, texts=once.texts * 2, queries=once.queries.expand(2, -1))
    with refuses():
        queried.field.label(replace(twice, texts=("word 1", "none")))
    found = queried.field.label(twice)
    assert found.names == ("word 1",)
    assert found.ids.equal(queried.field.label(once).ids)


ALL = ("sidecar", "ids", "colors", "glb", "usd", "clouds", "maps", "sheet")


@pytest.fixture(scope="module")
def labels(queried: Queried) -> GaussianLabels:
    return queried.field.label(queried.texts)


def labels_of(
    ids: torch.Tensor, words: tuple[str, ...], instances: torch.Tensor, things: tuple[int, ...] = ()
) -> GaussianLabels:
    answers = (
        Answer(word, ids == number, "m", None, replace(ASKED, word=word), things=things)
        for number, word in enumerate(words)
    )
    return GaussianLabels(ids, tuple(answers), instances)


def literal_map(queried: Queried, labels: GaussianLabels) -> np.ndarray:
    """Pixel by pixel the words' shares of its light, by one render a word."""
    projection = queried.field.project(queried.camera)
    numbers = [NONE, *range(len(labels.names))]
    masks = [(labels.ids == number).float()[:, None] for number in numbers]
    shares = [raster.render_channels(projection, mask)[0][..., 0].numpy() for mask in masks]
    painted = np.sum(shares, 0) >= 0.5
    return np.where(painted, np.array(numbers)[np.argmax(shares, 0)], NONE)


def test_maps_show_the_word_that_paints_most(queried: Queried, labels: GaussianLabels) -> None:
    count = 2 * AT_A_TIME + 5  # more than are rendered together
    ids = torch.arange(len(queried.field)).int() % (count + 1) - 1
    names = tuple(f"thing {number}" for number in range(count))
    for each in (labels, labels_of(ids, names, torch.full_like(ids, NONE))):
        found = label_map(queried.field.at(queried.camera), each)
        assert np.array_equal(found.numpy(), literal_map(queried, each))
        assert len(found.unique()) >= 3


def test_all_files_agree(queried: Queried, labels: GaussianLabels, tmp_path: Path) -> None:
    files = LabelFiles(labels.names, ALL, [replace(queried.camera, name="first.png")])
    assert files.write(queried.field, labels, tmp_path) == []
    written = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert written == set(files.names)
    rows = PlyTable.read(tmp_path / "labels.ply").rows
    ids = np.load(tmp_path / "labels.npy", allow_pickle=False)
    for found, expected in (
        (ids, labels.ids),
        (rows["label"], labels.ids),
        (rows["thing"], labels.instances),
    ):
        assert found.dtype == np.int32
        assert found.tolist() == expected.tolist()
    record = json.loads((tmp_path / "labels.json").read_text())
    assert record == json.loads(json.dumps(labels.to_dict() | {"frame": queried.field.world.to_dict()}))
    for entry in record["classes"]:
        assert entry["gaussians"] == int((labels.ids == entry["id"]).sum())
        assert entry["level"] in queried.field.levels
    for name, file in ((labels.names[0], "word-0"), ("none", "none")):
        cloud = PlyTable.read(tmp_path / "clouds" / f"{file}.ply")
        means = np.stack([cloud.rows[axis] for axis in "xyz"], 1)
        assert np.array_equal(means, queried.field.gaussians.means[labels.mask(name)].numpy())
    with Image.open(tmp_path / "maps" / "first.png") as picture:
        assert picture.mode == "P"
        assert np.array_equal(np.asarray(picture).astype(int) - 1, literal_map(queried, labels))
        assert np.array_equal(np.array(picture.getpalette()).reshape(-1, 3)[1:12], label_colors(11))
    coco = json.loads((tmp_path / "maps" / "coco.json").read_text())
    areas = {entry["category_id"] - 1: entry["area"] for entry in coco["annotations"]}
    counts = np.bincount(literal_map(queried, labels).ravel() + 1, minlength=12)[1:]
    assert areas == {number: count for number, count in enumerate(counts.tolist()) if count}
    assert features_of(tmp_path / "labels.glb") == (labels.ids.tolist(), labels.names)
    assert read_gltf(tmp_path / "labels.glb").means.equal(queried.field.gaussians.means)


def usd_of(field: LanguageField, labels: GaussianLabels, folder: Path) -> Any:
    """The stage that is written."""
    usd = pytest.importorskip("pxr.Usd", reason="usd-core is not installed")
    LabelFiles(labels.names, ("usd",)).write(field, labels, folder)
    return usd.Stage.Open(str(folder / "labels.usdc"))


@pytest.mark.parametrize("asked", ["queried", "voted"])
def test_a_prim_for_each_thing(asked: str, request: pytest.FixtureRequest, tmp_path: Path) -> None:
    scene: Queried = request.getfixturevalue(asked)
    labels = scene.field.label(scene.texts)
    stage = usd_of(scene.field, labels, tmp_path)
    UsdGeom, UsdPhysics, UsdSemantics, UsdValidation = (
        import_module(f"pxr.Usd{name}") for name in ("Geom", "Physics", "Semantics", "Validation")
    )
    checks = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    assert [error.GetMessage() for error in checks.Validate(stage)] == []
    means = lambda prim: np.array(prim.GetAttribute("positions").Get()) * [1, -1, -1]  # noqa: E731
    expected = scene.field.gaussians.means.numpy()
    root, found, up = stage.GetDefaultPrim(), 0, estimate_up(scene.field.cameras or ())
    for prim in root.GetChildren():
        if prim.GetName() == "Rest":
            assert np.array_equal(means(prim), expected[labels.mask("none")])
            continue
        (name,) = UsdSemantics.LabelsAPI(prim, "class").GetLabelsAttr().Get()
        thing = int(prim.GetName().rsplit("_", 1)[1])
        mine = labels.mask(name) & (labels.instances == (thing if asked == "queried" else NONE))
        assert np.array_equal(means(prim.GetChild("Splat")), expected[mine])
        box = UsdGeom.Cube(prim.GetChild("Box"))
        assert box.GetPrim().HasAPI(UsdPhysics.CollisionAPI)
        assert box.GetPurposeAttr().Get() == "guide"
        (wanted,) = PointSets.of(scene.field.gaussians, [mine.nonzero()[:, 0]]).boxes(up)
        assert wanted is not None
        place = UsdGeom.Imageable(box).ComputeLocalToWorldTransform(0)
        corners = [place.Transform(tuple(corner)) for corner in itertools.product((-0.5, 0.5), repeat=3)]
        assert np.allclose(corners, wanted.corners() * torch.tensor([1, -1, -1]), atol=1e-6)
        found += int(mine.sum())
    assert found == int((labels.ids != NONE).sum()) > 0


def test_words_that_read_alike_have_prims_of_their_own(queried: Queried, tmp_path: Path) -> None:
    rows = torch.arange(len(queried.field)).int()
    labels = labels_of(rows % 2, ("a b", "a-b"), rows % 4 // 2 - 1, things=(0,))
    stage = usd_of(queried.field, labels, tmp_path)
    prims = stage.GetDefaultPrim().GetChildren()
    beyond = len(queried.field.thing_table or ())
    assert {prim.GetName() for prim in prims} == {"a_b_0", "a_b__0", f"a_b_{beyond}", f"a_b_{beyond + 1}"}


def test_colours_are_those_of_the_words(queried: Queried, labels: GaussianLabels, tmp_path: Path) -> None:
    shown = labelled_colors(queried.field.gaussians, labels)
    LabelFiles(labels.names, ("colors",)).write(queried.field, labels, tmp_path)
    assert torch.allclose(read_ply(tmp_path / "colored.ply").sh, shown.sh, atol=1e-6)
    assert shown.means.equal(queried.field.gaussians.means)
    rgb = shown.sh[:, 0] * SH_C0 + 0.5
    grey = rgb[labels.ids == NONE]
    assert (grey.amax(1) - grey.amin(1) < 1e-5).all()
    # A colour times a lightness keeps its proportions, unless a channel is full.
    own = (labels.ids != NONE) & (rgb.amax(1) < 1 - 1e-4)
    colors = torch.from_numpy(label_colors(len(labels.names))).float()[labels.ids[own].long()]
    shares, expected = (each / each.amax(1, keepdim=True) for each in (rgb[own], colors))
    assert len(shares) > 9
    assert torch.allclose(shares, expected, atol=1e-3)
