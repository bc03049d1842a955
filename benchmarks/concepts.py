"""Answers and names with a detector that takes words, beside those of the field alone, on scenes of real models."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.answer_presence import auc
from benchmarks.answer_scenes import AnswerScene, SceneSize, make_scene
from benchmarks.data import data_folder
from benchmarks.drawn import DrawnAnswer, mask_ious, question_of
from benchmarks.real_scenes import FOLDERS, REAL_SCENES, TUNED_ON, RealScene, place_of
from benchmarks.study import Record, Study
from benchmarks.ways import WAYS
from scoup.base import InputError
from scoup.field import NameTable, ThingTable
from scoup.models import CANONICAL_PHRASES, with_everyday
from scoup.query import LanguageField, constants
from scoup.query.answer_scene import each_answer
from scoup.query.field_view import counting_gaussians
from scoup.query.named import best_words, voted_names
from scoup.query.refinement import choose_views
from scoup.scene import Detections
from scoup.uplift.naming import ViewVotes, count_votes, things_in_view, votes_in_view
from scoup_lab.baselines.fitted import FittedField
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.bench import markdown

ANSWERS = ("field", "detector alone", "on demand", "at extraction")
RIGHT_FROM = 0.5
"""A thing has a right name if its mean IoU with the truth is at least this."""


@dataclass(frozen=True, kw_only=True)
class Concepts(Study):
    """Score answers, presence and names with a detector that takes words.

    Detections were made by a script outside of the project, for all words of desk's table: DETECTIONS/SCENE/VIEW.npz
    with word [M] (position among the words), score [M], box [M, 4] in pixels and size [2].

    field: without the detector. detector alone: things with most votes. on demand: `scoup query --refine` for each
    word. at extraction: votes of all words in all photographs. mIoU is that of `scoup query --always`.
    """

    detections: Path
    """Folder of the detections."""
    scenes: tuple[str, ...] = tuple(name for name in REAL_SCENES if place_of(name) in TUNED_ON)
    """Scenes of benchmarks.real_scenes; others have no detections."""
    views: int = constants.MOST_PHOTOGRAPHS
    """Photographs looked at on demand."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains desk/ and real/."""

    def check(self) -> None:
        if not self.detections.is_dir():
            raise InputError(f"{self.detections}: there is no such folder of detections")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        votes: dict[str, dict[str, ViewVotes]] = {}
        for name in self.scenes:
            if name in known:
                continue
            scene, opened = make_scene(name, self.data, SceneSize()), RealScene.open(name, self.data)
            fitted = WAYS["default"].uplift(scene.inputs(), MethodSettings(2))
            assert isinstance(fitted, FittedField)
            fitted.field.attach(scene.gaussians, known=True)
            vectors = (*scene.everyday, *scene.canonical[: len(CANONICAL_PHRASES)])
            words = dict(zip((*scene.words, *CANONICAL_PHRASES), vectors, strict=True))
            asked = LanguageField.of(fitted.field, words)
            table, place = asked.thing_table, place_of(name)
            assert table is not None
            if place not in votes:  # both poolings have the same things
                folder = self.detections / FOLDERS[place].removeprefix("real/")
                votes = {place: {}}
                for camera in opened.cameras:
                    view = things_in_view(scene.gaussians, table, camera, "inria")
                    found = read_detections(folder / f"{Path(camera.name).stem}.npz")
                    votes[place][camera.name] = votes_in_view(view, found, len(scene.words))
            yield name, self._score(scene, opened, asked, votes[place])

    def _score(
        self, scene: AnswerScene, opened: RealScene, asked: LanguageField, votes: Mapping[str, ViewVotes]
    ) -> Record:
        table = asked.thing_table
        assert table is not None
        labels, absent = tuple(scene.queries), tuple(word for word in scene.absent if word in scene.words)
        texts = (*labels, *(word for word in absent if word not in labels))
        everyday = with_everyday(scene.canonical, scene.everyday)
        names = count_votes(scene.words, list(votes.values()))
        on_demand = self._on_demand(scene, opened, asked, votes, texts)
        best = best_things(scene, table)
        figures: Record = {"names": {}}
        tables = {"field": None, "detector alone": on_demand, "on demand": on_demand, "at extraction": names}
        for way, given in tables.items():
            named = asked.changed(scene.gaussians, thing_table=replace(table, names=given))
            answers = list(each_answer(named, question_of(scene, texts, everyday)))
            drawn = {each.text: DrawnAnswer(each.mask, counting_gaussians(named, each)) for each in answers}
            sure = {each.text: each.score or 0.0 for each in answers}
            if way == "detector alone" and given is not None:
                drawn = {text: voted(asked, table, given, text) for text in labels}
                sure = dict(zip(given.texts, given.presence.tolist(), strict=True))
            figures[way] = {
                "mIoU": round(mean(iou for iou, *_ in mask_ious(scene, drawn)), 4),
                "presence": round(
                    auc(*(np.array([sure[text] for text in some]) for some in (labels, absent))), 4
                ),
            }
        named = asked.changed(scene.gaussians, thing_table=replace(table, names=names))
        for title, words in {"words of the scene and absent ones": texts, "all words": scene.words}.items():
            vectors = torch.stack([scene.everyday[scene.words.index(word)] for word in words])
            embedded = best_words(table.embeddings.float() @ vectors.T)[:, 0].tolist()
            given = voted_names(named, words)
            figures["names"][title] = {
                "things": len(best),
                "field": sum(words[embedded[thing]] == label for label, thing in best.items()),
                "at extraction": sum(
                    (given[thing][0][0] if thing in given else words[embedded[thing]]) == label
                    for label, thing in best.items()
                ),
            }
        return figures

    def _on_demand(
        self,
        scene: AnswerScene,
        opened: RealScene,
        asked: LanguageField,
        votes: Mapping[str, ViewVotes],
        texts: Sequence[str],
    ) -> NameTable:
        names = None
        for text in texts:
            row = scene.words.index(text)
            views = choose_views(asked, [text], opened.cameras, self.views)
            found = count_votes([text], [votes[view.name].of_text(row) for view in views])
            names = found if names is None else names.joined(found)
        assert names is not None
        return names

    def line(self, figures: Any) -> str:
        return "  ".join(f"{way} {figures[way]['mIoU']:.3f}" for way in ANSWERS)

    def record(self, rows: dict[str, Any]) -> Record:
        return {
            "rows": rows,
            "means": {
                figure: {way: round(mean(of[way][figure] for of in rows.values()), 4) for way in ANSWERS}
                for figure in ("mIoU", "presence")
            },
        }

    @staticmethod
    def table(record: Record) -> str:
        """Return mIoU per scene, and means, presence and names."""
        rows = record["rows"]
        body = [[name, *(f"{of[way]['mIoU']:.3f}" for way in ANSWERS)] for name, of in rows.items()]
        body += [
            [f"mean {figure}", *(f"{of[way]:.3f}" for way in ANSWERS)]
            for figure, of in {
                "mIoU": record["means"]["mIoU"],
                "AUC of presence": record["means"]["presence"],
            }.items()
        ]
        for title in next(iter(rows.values()))["names"]:
            of = [each["names"][title] for each in rows.values()]
            total = sum(each["things"] for each in of)
            right = {
                way: f"{sum(each[way] for each in of) / total:.2f}" for way in ("field", "at extraction")
            }
            body.append([f"names right, {title}", *(right.get(way, "") for way in ANSWERS)])
        return markdown(["scene, mIoU", *ANSWERS], body)


def read_detections(path: Path) -> Detections:
    """Read what the detector found in one photograph."""
    with np.load(path) as stored:
        word, score, box, size = (torch.from_numpy(stored[name]) for name in ("word", "score", "box", "size"))
    return Detections(word.long(), score.float(), box.float(), (int(size[0]), int(size[1])))


def voted(asked: LanguageField, table: ThingTable, names: NameTable, text: str) -> DrawnAnswer:
    """Return the things with most votes for a text, without the field's opinion."""
    votes = names.votes_of(names.number(text) or 0, len(table))
    level = int(table.levels[votes.argmax()])
    things = ((votes >= constants.TOGETHER * votes.max()) & (votes > 0) & (table.levels == level)).nonzero()[
        :, 0
    ]
    mask = table.members(things) if len(things) else torch.zeros(len(asked), dtype=torch.bool)
    return DrawnAnswer(mask, mask | table.owned[level])


def best_things(scene: AnswerScene, table: ThingTable) -> dict[str, int]:
    """Return the thing with the largest mean IoU with the truth of each label, where it is at least ``RIGHT_FROM``."""
    sums: dict[str, Tensor] = {}
    frames: dict[str, int] = {}
    for (frame, _), camera in zip(scene.frames, scene.cameras, strict=True):
        masks = things_in_view(scene.gaussians, table, camera, "inria").masks
        for label in frame.labels:
            truth = (
                torch.nn.functional.interpolate(
                    frame.masks[label][None, None].float(), masks.shape[1:], mode="area"
                )[0, 0]
                > 0.5
            )
            both, either = (masks & truth).sum((1, 2)), (masks | truth).sum((1, 2))
            sums[label] = sums.get(label, torch.zeros(len(table))) + both / either.clamp(min=1)
            frames[label] = frames.get(label, 0) + 1
    means = {label: total / frames[label] for label, total in sums.items()}
    return {label: int(of.argmax()) for label, of in means.items() if of.max() >= RIGHT_FROM}
