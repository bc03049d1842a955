"""A vocabulary with the answers of a scene to each of its words, for a page that has no server."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

import numpy as np
import torch
from numpy.typing import NDArray

from scoup.field import Field
from scoup.query import Certainty, Question, phrase_data
from scoup.view.packing import packed
from scoup.view.scene_answers import PageAnswer
from scoup.view.scene_data import NO_OWNER

_NONE = 255  # of a certainty


def words_data(field: Field, question: Question, answers: Sequence[PageAnswer]) -> bytes:
    """Return the file of words in an exported page, packed as ``scene_data`` packs the scene; V words.

    gram [S, L, L] float16, inner products of atoms. scores [V, S, L] float16, of word and atoms. thresholds [V, S].
    spans [V, S, 2], relevancies that rescaling takes to 0 and 1. levels, present, certainty [V] uint8 (255: not known).
    score [V], gaussians [V] int32. With things: runner_up [V] uint16 (65535: none), runner_up_score [V], thing_counts
    [V, 2 + S] and things [M] uint16 (``_things``), and the arrays of ``scoup.query.phrase_data``. Other numbers are
    float32. Metadata: names, certainties, remarks; with things, the facts of ``phrase_data``.
    """
    verdicts = [answer.verdict for answer in answers]
    words = get_args(Certainty)
    certainties = [
        _NONE if verdict["certainty"] is None else words.index(verdict["certainty"]) for verdict in verdicts
    ]
    rivals = [verdict["runner_up"] or {"thing": NO_OWNER, "score": None} for verdict in verdicts]
    codebook = field.codebook.float().cpu()
    tensors = {
        "gram": (codebook @ codebook.transpose(1, 2)).half().numpy(),
        "scores": torch.stack([answer.scores for answer in answers]).half().numpy(),
        "thresholds": torch.stack([answer.thresholds for answer in answers]).float().numpy(),
        "spans": torch.stack([answer.spans for answer in answers]).float().numpy(),
        "levels": np.array([answer.level for answer in answers], np.uint8),
        "score": np.array([verdict["score"] for verdict in verdicts], np.float32),  # None becomes NaN
        "certainty": np.array(certainties, np.uint8),
        "present": np.array([verdict["present"] for verdict in verdicts], np.uint8),
        "gaussians": np.array([verdict["gaussians"] for verdict in verdicts], np.int32),
    }
    remarks = [answer.remark for answer in answers]
    metadata = {"names": question.texts, "certainties": words, "remarks": remarks}
    if answers[0].chosen_things is not None:
        parts, arrays, facts = phrase_data(
            field, question, [answer.chosen_things or () for answer in answers]
        )
        tensors |= {**_things(answers, parts), **arrays}
        tensors["runner_up"] = np.array([rival["thing"] for rival in rivals], np.uint16)
        tensors["runner_up_score"] = np.array([rival["score"] for rival in rivals], np.float32)
        metadata |= facts
    return packed(tensors, metadata, 9)


def _things(answers: Sequence[PageAnswer], parts: Sequence[list[int]]) -> dict[str, NDArray[np.uint16]]:
    """Return the number of things that answer each word, [V, 2 + S], without and with a level of choice, and of the
    parts of the first that fit it best; and their numbers, one after the other."""
    choices = [
        [answer.chosen_things, *answer.things, part] for answer, part in zip(answers, parts, strict=True)
    ]
    counts = [[0 if choice is None else len(choice) for choice in row] for row in choices]
    numbers = [number for row in choices for choice in row for number in choice or ()]
    return {"thing_counts": np.array(counts, np.uint16), "things": np.array(numbers, np.uint16)}
