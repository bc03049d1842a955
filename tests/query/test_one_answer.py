"""One answer: no two ways to ask a scene for a text contradict each other."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest
import torch

from children import finished
from query.conftest import without_things
from scoup import raster
from scoup.io import load_cameras, load_gaussians, load_regions
from scoup.query import constants, matching
from scoup.query.answer import Answer
from scoup.query.language_field import LanguageField, build
from scoup.query.question import Question, literal
from scoup.query.view_answer import ViewAnswer, main_parts
from scoup.scene import Camera
from scoup.uplift import BuildSettings
from scoup_lab.data.labels import read_labels
from scoup_lab.synthetic.scene import make_demo_scene

SETTINGS = BuildSettings(n_atoms=32, epochs=200)
ROUNDING = 1e-5  # of shares of pixels


def check_scene(field: LanguageField, question: Question) -> Answer:
    """Ask for one text in every way that the scene has."""
    (text,) = question.texts
    answer = field.answer(question)
    things, place, labels = field.things(question), field.location(question), field.label(question)
    selected = field.select(question)
    assert selected.mask.equal(answer.mask)
    assert selected.to_dict() == answer.to_dict()
    assert (bool(answer.mask.any()), bool(answer.things)) == (
        bool(things), bool(things) and field.thing_table is not None,
    )  # fmt: skip
    if not answer.presence:
        assert not things
    assert [thing.number for thing in things if thing.number is not None] == list(answer.things)
    assert {thing.level for thing in things} <= {answer.level}
    assert {thing.text for thing in things} <= {text}
    of_things = torch.zeros(len(field), dtype=torch.bool)
    for thing in things:
        of_things[thing.gaussians] = True
    if answer.things:
        assert of_things.equal(answer.mask)
        assert things[0].score == answer.score
        scores = [thing.score or 0.0 for thing in things]
        assert scores == sorted(scores, reverse=True)
        assert answer.runner_up is None or answer.runner_up.thing not in answer.things
    else:  # connected parts, without strays
        assert not (of_things & ~answer.mask).any()
    for found in (place, field.location(answer)):
        assert found.answer.to_dict() == answer.to_dict()
        first = None if found.thing is None else found.thing.to_dict()
        assert first == (things[0].to_dict() if things else None)
        assert found.presence == bool(things)
        assert found.position is None or found.position.equal(things[0].position)
    assert labels.mask(text).equal(answer.mask)
    assert [each.to_dict() for each in labels.answers] == [answer.to_dict()]
    return answer


def check_view(seen: ViewAnswer, answer: Answer, shares: torch.Tensor, whole: torch.Tensor) -> None:
    """Compare an answer in a view with the shares [H, W] of its Gaussians, and of all that count."""
    assert (seen.text, seen.level, seen.score, seen.presence) == (
        answer.text, answer.level, answer.score, answer.presence,
    )  # fmt: skip
    clear = (shares - constants.PIXEL_SHARE * whole).abs() > ROUNDING
    assert seen.mask[clear].equal((shares > constants.PIXEL_SHARE * whole)[clear])
    parts, largest = main_parts(seen.mask)
    assert seen.main_parts.equal(parts)
    assert not (parts & ~seen.mask).any()
    if not seen.mask.any():
        assert (seen.point, seen.box, seen.visible, seen.coverage) == (None, None, False, 0)
        return
    rows, columns = parts.any(1).nonzero()[:, 0], parts.any(0).nonzero()[:, 0]
    assert seen.box == (int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1)
    assert seen.point is not None
    x, y = seen.point
    assert bool(largest[y, x])
    assert bool(seen.mask[y, x])
    assert float(shares[y, x]) > constants.PIXEL_SHARE * float(whole[y, x]) - ROUNDING


def check_words(field: LanguageField, words: Sequence[str]) -> list[Answer]:
    """Ask for each word alone, with others, and with a refusal of absence; return the answers of the last."""
    judged = field.answer(field.question(list(words)))
    assert {answer.presence for answer in judged} == {True, False}
    forced = field.answer(field.question(list(words), always=True))
    for word, one, other in zip(words, judged, forced, strict=True):
        for expected, always in ((one, False), (other, True))[: 1 if one.presence else 2]:
            alone = check_scene(field, field.question(word, always=always))
            assert alone.mask.equal(expected.mask)
            assert alone.to_dict() == expected.to_dict()
        assert (one.level, one.score) == (other.level, other.score)
        assert one.to_dict() == other.to_dict() or not one.presence
    return forced


def check_catalog(field: LanguageField, answers: Sequence[Answer]) -> None:
    catalog = field.catalog([answer.text for answer in answers])
    named = [thing for thing in catalog.things if thing.text]
    assert named
    assert set(catalog.objects) <= {thing.number for thing in catalog.things}
    # Whoever asks for a name finds its thing, or one of another level with the same Gaussians.
    for thing in named:
        found = field.things(field.question(literal([thing.text]), always=True))
        assert thing.score is None  # only answers have scores
        own = set(thing.gaussians.tolist())
        alike = [len(own & (of := set(each.gaussians.tolist()))) / len(own | of) for each in found]
        assert max(alike) >= constants.SAME_GAUSSIANS


def check_everything(field: LanguageField, words: Sequence[str], cameras: Sequence[Camera]) -> None:
    answers, table = check_words(field, words), field.thing_table
    counting = field.coded_levels() if table is None else table.owned
    masks = torch.stack([*(answer.mask for answer in answers), *counting], 1).float()
    for camera in cameras:
        view = field.at(camera)
        image = raster.render_values(view.projection, masks)
        seen = view.answer(field.question(list(words), always=True))
        for number, (each, answer) in enumerate(zip(seen, answers, strict=True)):
            whole = image[..., len(words) + field.level_index(answer.level)]
            check_view(each, answer, image[..., number], whole)
        for number, answer in enumerate(answers[:3]):
            one = field.question(words[number], always=True)
            for alone in (answer, field.answer(one), field.select(one)):
                for shown in (view.show([alone])[0], field.at(camera).show([alone])[0]):
                    assert shown.mask.equal(seen[number].mask)
                    torch.testing.assert_close(shown.heat, seen[number].heat, atol=1e-5, rtol=0)
    if table is not None:
        check_catalog(field, answers)


@pytest.fixture(scope="module")
def demo() -> tuple[LanguageField, list[str]]:
    scene = make_demo_scene(0, 4000, 96, 72, 6, 0)
    known = dict(zip(scene.words.texts, torch.from_numpy(scene.words.vectors), strict=True))
    field = build(scene.gaussians, scene.building, scene.regions, SETTINGS).with_encoder(known)
    names = {name for level in field.levels for name in scene.parts.names(level)}
    words = [word for word in scene.words.texts if word in names]
    others = [word for word in scene.words.texts if word not in names]
    return field, [*words[::3], *others[:5]]


@pytest.mark.parametrize("has_things", [True, False])
def test_the_demo_scene(demo, has_things: bool, monkeypatch) -> None:
    field, words = demo
    assert field.cameras is not None
    assert field.thing_table is not None
    monkeypatch.setattr(matching, "FITS_AT_A_TIME", 5 * len(field.thing_table))  # several passes
    assert len(words) > 5
    check_everything(field if has_things else without_things(field), words, list(field.cameras)[::3])


def photographed(folder: Path) -> LanguageField:
    gaussians, cameras = load_gaussians(folder / "point_cloud.splat"), load_cameras(folder)
    return build(gaussians, cameras, load_regions(folder / "language_features", cameras), SETTINGS)


def desk(data: Path, _: Path) -> tuple[LanguageField, list[str]]:
    field = photographed(data / "desk").with_encoder(data / "desk" / "desk_words.npz")
    return field, ["kettle", "laptop computer", "penguin"]


def kitchen(data: Path, out: Path) -> tuple[LanguageField, list[str]]:
    folder = data / "kitchen"
    script = [sys.executable, folder / "make_langsplat_features.py", folder, "--out", out]
    finished(script, check=True)
    cameras = load_cameras(folder, downscale=4)
    regions = load_regions(out, cameras)
    field = build(load_gaussians(folder / "scene" / "model.splat"), cameras, regions, SETTINGS)
    field = field.with_encoder(data / "clip" / "text_vit_b16_laion2b.npz")
    return field, sorted({name for frame in read_labels(folder / "label") for name in frame.labels})


def real(name: str) -> Callable[[Path, Path], tuple[LanguageField, list[str]]]:
    def made(data: Path, _: Path) -> tuple[LanguageField, list[str]]:
        field = photographed(data / "real" / name).with_encoder(data / "desk" / "desk_words.npz")
        return field, list(json.loads((data / "real" / name / "words.json").read_text()))

    return made


REAL = {
    "desk": desk,
    "kitchen": kitchen,
    **{f"real/{name}": real(name) for name in ("table-20", "shelves-20", "hall-20", "yard-20")},
}


@pytest.mark.data
@pytest.mark.slow
@pytest.mark.parametrize("name", REAL)
def test_a_real_scene(data_folder: Path, tmp_path: Path, name: str) -> None:
    if not (data_folder / name).is_dir():
        pytest.skip(f"no {name} in {data_folder}")
    field, words = REAL[name](data_folder, tmp_path)
    known = field.encoder.names
    absent = [word for word in known if word not in words][:: max(1, len(known) // 12)]
    assert field.cameras is not None
    check_everything(field, [*words, *absent], field.cameras.scaled(0.25)[:: len(field.cameras) // 3])
