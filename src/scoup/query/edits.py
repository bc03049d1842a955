"""Edits of a scene: selections kept, removed, recoloured and faded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.query.answer import Answer
from scoup.query.coded_scene import CodedScene
from scoup.query.expression import Expression
from scoup.query.reshape import UNCHANGED, Reshaping, reshaped
from scoup.scene.gaussians import SH_C0, Gaussians

Edit = Literal["keep", "remove", "recolor", "fade"]


def combined_answer(
    field: CodedScene,
    expression: Expression,
    answers: Sequence[Answer],
    wanted: Reshaping = UNCHANGED,
    phrases: Mapping[str, Tensor] = MappingProxyType({}),  # [N] boolean of each of its phrases, by its text
) -> Answer:
    """Return the answer to an expression, from one answer of ``answer_scene`` per text; ``field.select`` calls this.

    Level, score, runner-up and threshold are those of the wanted text with the largest score.
    """
    of_text = {answer.text: answer for answer in answers}
    mask = expression.combine({**{text: answer.mask for text, answer in of_text.items()}, **phrases})
    wanted_answers = [of_text[text] for text in expression.wanted]
    best = max(wanted_answers, key=lambda answer: (answer.presence, answer.score or 0.0))
    asked = tuple(one for answer in wanted_answers for one in answer.asked)
    whole = replace(best, mask=mask, parts=tuple(answers), asked=asked)
    if wanted.changes:
        whole = replace(whole, mask=reshaped(field.gaussians, mask, whole.relevancy(), wanted))
    if len(of_text) == 1 and expression.is_plain:
        return whole
    things = tuple(dict.fromkeys(thing for answer in wanted_answers for thing in answer.things))
    presence = best.presence if expression.is_plain else bool(whole.mask.any())
    return replace(
        whole, text=str(expression), presence=presence, things=things if expression.is_plain else ()
    )


def edited(
    gaussians: Gaussians,
    mask: Tensor,
    edit: Edit,
    color: tuple[float, float, float] = (1.0, 0.36, 0.16),
    opacity: float = 0.15,
) -> Gaussians:
    """Edit the Gaussians in a selection.

    Args:
        gaussians: N of them.
        mask: [N] boolean, the selection.
        edit: "keep" keeps only the selection, "remove" all others; "recolor" gives the selection a colour, with its
            light and shade as far as they do not depend on the direction of view; "fade" scales its opacities.
        color: of "recolor": red, green and blue, 0 to 1.
        opacity: of "fade": factor, 0 to 1.
    """
    if not 0 <= opacity <= 1 or not all(0 <= part <= 1 for part in color):
        raise InputError(f"opacity and colour must be 0 to 1, got {opacity} and {list(color)}")
    mask = mask.to(gaussians.device)
    if edit in ("keep", "remove"):
        return gaussians.select(mask if edit == "keep" else ~mask)
    if edit == "fade":
        return replace(
            gaussians, opacities=torch.where(mask, gaussians.opacities * opacity, gaussians.opacities)
        )
    sh = gaussians.sh.clone()
    sh[mask] = 0
    sh[mask, 0] = (_shaded(gaussians.sh[mask, 0] * SH_C0 + 0.5, color) - 0.5) / SH_C0
    return replace(gaussians, sh=sh)


def _shaded(rgb: Tensor, color: tuple[float, float, float]) -> Tensor:
    """A colour with the lightness of colours [M, 3] relative to their median."""
    lightness = rgb.clamp(0, 1).mean(1)
    usual = lightness.median().clamp(min=0.05) if len(lightness) else lightness.new_ones(())
    share = (lightness / usual).clamp(0.25, 1.75)[:, None]
    return (rgb.new_tensor(color) * share).clamp(0, 1)
