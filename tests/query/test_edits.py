"""What edits make of Gaussians and of fields, and the rows of a splat's file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch

from messages import refuses
from query.conftest import Queried
from scoup.io import PlyTable, save_gaussians
from scoup.query.answer import answer_relevancy
from scoup.query.ask import each_answer
from scoup.query.drawings import moving_cameras
from scoup.query.edits import SceneEdit, SplatTable, best_camera, edited
from scoup.query.expression import parse_expression
from scoup.query.question import Question
from scoup.scene import SH_C0, Camera, Cameras
from support import random_gaussians


def test_edits() -> None:
    gaussians = random_gaussians(30, seed=1)
    mask = torch.arange(30) < 12
    assert edited(gaussians, mask, "keep").means.equal(gaussians.means[mask])
    assert edited(gaussians, mask, "remove").means.equal(gaussians.means[~mask])
    faded = edited(gaussians, mask, "fade", opacity=0.25)
    assert faded.opacities.equal(torch.where(mask, gaussians.opacities * 0.25, gaussians.opacities))
    for wrong in (-0.1, 1.1, float("nan")):
        for options in ({"edit": "fade", "opacity": wrong}, {"edit": "recolor", "color": (wrong, 0, 0)}):
            with refuses():
                edited(gaussians, mask, **options)
    found = edited(gaussians, mask, "recolor", (0.2, 0.6, 0.4))
    assert found.sh[~mask].equal(gaussians.sh[~mask])
    assert not found.sh[mask, 1:].any()
    assert found.opacities.equal(gaussians.opacities)
    before, after = ((each.sh[mask, 0] * SH_C0 + 0.5).mean(1) for each in (gaussians, found))
    assert (after[before.clamp(0, 1).argsort()].diff() >= -1e-6).all()  # light and shade stay
    assert edited(gaussians, mask & False, "recolor").sh.equal(gaussians.sh)


def asked(texts: Question, *words: str) -> Question:
    return replace(texts, asked=tuple((word, parse_expression([word])) for word in words))


def test_an_expression_is_answered_by_its_texts(queried: Queried) -> None:
    field, texts = queried.field, queried.texts
    answers = list(each_answer(field, texts))
    masks = {answer.text: answer.mask for answer in answers}
    two = [answer for answer in answers if answer.text in ("word 1", "word 2")]
    found = field.select(asked(texts, "word 1 and not word 2"))
    assert found.mask.equal(masks["word 1"] & ~masks["word 2"])
    assert answer_relevancy(field, found).equal(answer_relevancy(field, two[0]))
    assert (found.level, found.score, found.text) == (two[0].level, two[0].score, "word 1 and not word 2")
    both = field.select(asked(texts, "word 1", "word 2"))
    each = torch.stack([answer_relevancy(field, answer) for answer in two])
    assert answer_relevancy(field, both).equal(each.amax(0))
    assert both.mask.equal(two[0].mask | two[1].mask)
    assert both.score == max(each.score or 0 for each in two)
    assert both.things == tuple(dict.fromkeys(two[0].things + two[1].things))


def test_a_field_goes_with_its_edited_splat(queried: Queried) -> None:
    field = queried.field
    faded = field.with_gaussians(edited(field.gaussians, torch.arange(len(field)) < 20, "fade"))
    assert faded.code_indices.equal(field.code_indices)
    assert faded.info.provenance["selected_from"] == field.fingerprint
    with refuses():
        field.with_gaussians(field.gaussians.select([0, 1]))


def test_the_camera_that_sees_most_is_taken(queried: Queried) -> None:
    field = queried.field
    assert field.cameras is not None
    away = Camera.look_at((0, 0, -50), (0, 0, -100), "away.png", 40, 30, 30.0, up=(0, 1, 0))
    mask = torch.ones(len(field), dtype=torch.bool)
    chosen = best_camera(field, mask, [away, *field.cameras])
    assert chosen.name != "away.png"
    picture = SceneEdit(field, mask, "remove", (1.0, 0.0, 0.0), 0.5).picture([chosen], "everything")
    middle, third = picture.shape[0] // 2, picture.shape[1] // 3
    before = picture[middle : middle + 40, 16 : third - 16]
    after = picture[middle : middle + 40, 2 * third + 16 : 3 * third - 16]
    assert before.max() > 40
    assert after.max() == 0  # nothing is left
    with refuses():
        best_camera(field, mask, [])


def test_a_turntable_needs_a_thing(queried: Queried) -> None:
    field = queried.field
    answer = next(iter(each_answer(field, queried.texts)))
    place = field.location(answer)
    assert field.cameras is not None
    moving = moving_cameras(field, place, field.cameras, "turntable", 6)
    assert place.position is not None
    distances = torch.stack([(camera.position - place.position).norm() for camera in moving])
    assert torch.allclose(distances, distances[0].expand(6))
    nowhere = field.location(field.select(asked(queried.texts, "word 0 and not word 0")))
    assert nowhere.position is None
    with refuses():
        moving_cameras(field, nowhere, field.cameras, "turntable", 6)
    assert len(moving_cameras(field, nowhere, Cameras(list(field.cameras)), "path", 6)) == 6


def test_rows_are_those_of_the_splat(queried: Queried, tmp_path: Path) -> None:
    gaussians = queried.field.gaussians
    save_gaussians(gaussians, tmp_path / "a.ply")
    stored = PlyTable.read(tmp_path / "a.ply")
    mask = torch.arange(len(gaussians)) % 3 == 0
    # The file holds rounded numbers, so it is not the geometry of this field: rows are made from the Gaussians.
    for rows in (SplatTable.of(queried.field), SplatTable.of(queried.field, tmp_path / "a.ply")):
        assert rows.is_gaussian.all()
        assert len(rows.table) == len(gaussians)
        chosen, _ = rows.select(mask).gaussians()
        assert torch.equal(chosen.means, gaussians.means[mask])
    rows = SplatTable(stored, torch.ones(len(gaussians), dtype=torch.bool))
    assert rows.select(mask).rows.tobytes() == stored.rows[mask.numpy()].tobytes()
    whole = SplatTable(stored, torch.arange(len(stored)) >= 2)  # the first two rows are no Gaussians
    column = whole.with_column("state", torch.ones(len(stored) - 2, dtype=torch.uint8), 4).rows["state"]
    assert column.dtype == "u1"
    assert column.tolist() == [4, 4, *[1] * (len(column) - 2)]
