"""The grammar, relations and parts of a scene as plain data, for pages that evaluate phrases without Python.

``viewer/src/phrases.ts`` parses, ``viewer/src/relations.ts`` compares spans; relations that need Gaussians are listed.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.field import Field
from scoup.query import constants
from scoup.query.expression import USAGE, name_forms
from scoup.query.frame import scene_frame
from scoup.query.phrases import WORDS
from scoup.query.question import Question
from scoup.query.relations import Shapes, touching_things
from scoup.query.thing_judge import thing_index
from scoup.query.thing_names import find_objects, named_things
from scoup.query.things import Thing, best_part_number

RULES = ("CLEAR", "OVER_PART", "CONTACT", "NEAR", "BETWEEN")


def phrase_data(
    field: Field, question: Question[Any], answers: Sequence[Sequence[int]]
) -> tuple[list[list[int]], dict[str, NDArray[Any]], dict[str, Any]]:
    """Return the data with which a page evaluates phrases over the texts of a question.

    Args:
        field: with T things.
        question: its texts name the objects, too.
        answers: the things that answer each text if presence is not judged.

    Returns:
        For each text, of each of its things the part that fits it best. Arrays: thing_spans [T, 3, 2] float64 along
        right, up and away, and thing_sizes [T] float64, NaN without Gaussians. on and inside [E, 2] uint16: the first
        thing is so to the second. parents [T] uint16. owner_sets [S, C] uint16, the things of a Gaussian, level by
        level, and owner_counts [C] int32, the Gaussians of each such set. objects [O] uint16. 65535 is no thing. Facts:
        grammar, rules, and seen_from, the name of the camera.
    """
    table, known, frame = field.thing_table, thing_index(field, question), scene_frame(field)
    assert table is not None
    assert known is not None
    every = zip(known.fits(question.queries).T, answers, strict=True)
    parts = [
        [best_part_number(table, known, fits.tolist(), thing) for thing in things] for fits, things in every
    ]
    objects = [thing.number for thing in find_objects(field, named_things(field, question))]
    things = Thing.of_table(field, range(len(table)))
    numbers, shapes = np.array([thing.number for thing in things], np.uint16), Shapes.of(field, things, frame)
    spans, sizes = np.full((len(table), 3, 2), np.nan), np.full(len(table), np.nan)
    spans[numbers], sizes[numbers] = shapes.spans, [thing.size for thing in things]
    touching = np.array([*touching_things(shapes)], int).reshape(-1, 4)
    sets, counts = np.unique(table.owners.cpu().numpy(), axis=0, return_counts=True)
    arrays = {
        "inside": numbers[touching[touching[:, 2] > 0, :2]],
        "on": numbers[touching[touching[:, 3] > 0, :2]],
        "thing_spans": spans,
        "thing_sizes": sizes,
        "parents": table.parents.cpu().numpy().astype(np.uint16),  # NO_THING, -1, becomes 65535
        "owner_sets": sets.T.astype(np.uint16),
        "owner_counts": counts.astype(np.int32),
        "objects": np.array(objects, np.uint16),
    }
    grammar = {**WORDS, "usage": USAGE, "whole": name_forms(question.texts)[1].pattern}
    rules = {name: getattr(constants, name) for name in RULES}
    return parts, arrays, {"grammar": grammar, "rules": rules, "seen_from": frame.seen_from}
