"""Sentences that refer to things, answered by things: "the mug left of the laptop" is read as a phrase.

The grammar is that of `scoup select` (``scoup.query.phrases``); left, right, front and back are meant from the labelled
view. A sentence that is no phrase (it says no relation that the grammar knows, or the word table lacks a name in it) is
asked as it is. The things that answer are scored by the pixels they contribute most of. Ours; see docs/protocols.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import mean
from typing import Any

import torch
from torch import Tensor

from scoup import Camera, LanguageField, TextEncoder, parse_expression, raster
from scoup.base.errors import InputError
from scoup_lab.evaluate.metrics import iou
from scoup_lab.evaluate.pixel_report import PixelScores
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.scores import PairScore, SceneScore, scene_score
from scoup_lab.evaluate.tables import Table, percent

RULES = "things"
PLAIN = "no relation"
COVERED = 0.5  # share of a pixel's light from which it shows the things


@dataclass(frozen=True)
class SentenceScore:
    """A scene scored by things."""

    score: SceneScore
    kinds: dict[str, str]  # sentence -> its relations or order, or ``PLAIN``


def score_sentences(scene: LabelledScene, field: LanguageField, source: str, title: str) -> SentenceScore:
    """Ask the things of a field for every sentence of every frame.

    Args:
        scene: whose labels are sentences.
        field: of the scene.
        source: the word table or model that turns texts into vectors.
        title: of the protocol, in tables.
    """
    pairs, kinds = [], {}
    with TextEncoder.open(source, device=field.codebook.device) as encoder:
        for frame, camera in scene.frames:
            truth, projection = frame.resized(camera.width, camera.height), field.project(camera)
            for sentence in frame.labels:
                kinds[sentence], members = ask_sentence(field, sentence, encoder, camera)
                image, alpha = raster.render_channels(projection, members.float()[:, None])
                mask = (image[..., 0] > COVERED * alpha.clamp(min=0.1)).cpu()
                found = iou(mask, truth.masks[sentence])
                pairs.append(PairScore(frame.name, sentence, found, None, -1, float("nan"), None))
    return SentenceScore(scene_score(scene.name, RULES, pairs, title), kinds)


def ask_sentence(
    field: LanguageField, sentence: str, encoder: TextEncoder, camera: Camera
) -> tuple[str, Tensor]:
    """Return what kind of phrase a sentence is, and the Gaussians [N] boolean of the things that answer it."""
    kinds: list[str] = []
    question = field.question([sentence], encoder=encoder, always=True)
    things = field.things(question)
    try:
        expression = parse_expression([sentence.strip().rstrip(".")])
        if expression.phrases:
            question = field.question(expression, encoder=encoder, always=True)
            things = field.things(question, field.frame(camera))
            kinds = [phrase.relation or phrase.order for phrase in expression.phrases]
    except InputError:
        pass  # an unknown relation, or a name that the word table lacks
    members = torch.zeros(len(field), dtype=torch.bool, device=field.codebook.device)
    for thing in things:
        members[thing.gaussians.to(members.device)] = True
    return " or ".join(kinds) or PLAIN, members


def sentence_report(
    stem: str,
    title: str,
    by_things: Sequence[SentenceScore],
    by_maps: Sequence[SceneScore],
    shared: dict[str, Any],
) -> Report:
    """Return the report on scenes whose sentences things answered.

    Args:
        stem: of the file names.
        title: of the protocol.
        by_things: of each scene.
        by_maps: the same scenes by the protocol's own rules.
        shared: settings of the run.
    """
    scores = PixelScores(title, RULES, tuple(each.score for each in by_things), settings=shared)
    report = scores.report(stem)
    relations = relation_rows(by_things, by_maps)
    rows = tuple(
        (kind, str(row["sentences"]), percent(row["things"]), percent(row["relevancy"]))
        for kind, row in relations.items()
    )
    table = Table(
        f"{title}: by relation, mIoU", ("relation", "pairs", "things", "relevancy of the sentence"), rows
    )
    return replace(
        report,
        tables=[*report.tables[:2], table, *report.tables[2:]],
        record={**report.record, "relations": relations},
        shown=3,
    )


def relation_rows(
    by_things: Sequence[SentenceScore], by_maps: Sequence[SceneScore]
) -> dict[str, dict[str, float]]:
    """Return per relation how many pairs have it, and mean IoU over them by both ways to answer."""
    found: dict[str, list[tuple[float, float]]] = {}
    for scene, other in zip(by_things, by_maps, strict=True):
        for one, by_map in zip(scene.score.pairs, other.pairs, strict=True):
            assert (one.frame, one.label) == (by_map.frame, by_map.label)
            found.setdefault(scene.kinds[one.label], []).append((one.iou, by_map.iou))
    return {
        kind: {
            "sentences": len(pairs),
            "things": mean(one for one, _ in pairs),
            "relevancy": mean(two for _, two in pairs),
        }
        for kind, pairs in sorted(found.items())
    }
