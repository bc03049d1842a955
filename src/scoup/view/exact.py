"""The method's own answers for the page: renders of any camera, and the words at a pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError, counted
from scoup.field import Field, relevancy
from scoup.pictures import Picture, as_picture, heat_overlay, texts_overlay
from scoup.query import Answer, FieldView, TextVectors, drawing
from scoup.scene import signed

Colors: TypeAlias = Sequence[tuple[float, float, float]]
PictureMode = Literal["color", "heat", "mask", "codes"]
LARGEST_SIDE = 4096
MOST_FOR_TEXTS = 1 << 26
"""Most pixels * (texts + 4) of heat and masks. Each takes about 60 bytes, 4 GB in all."""
_WORDS_SHOWN = 5


def draw_picture(
    view: FieldView,
    mode: PictureMode,
    answers: Sequence[Answer],
    colors: Colors,
    opacity: float,
    level: int | None,
) -> Picture:
    """Return [H, W, 3] uint8 of the camera's size, without lettering.

    Heat is relevancy over the splat, of several answers in their ``colors`` (0..255), as are masks; codes are those of
    the level at this position, None: the middle one.

    Raises:
        InputError: a value is out of range, or a text is missing.
    """
    if mode not in get_args(PictureMode):
        raise InputError(f"a picture must show one of {', '.join(get_args(PictureMode))}, got {mode!r}")
    if max(view.camera.width, view.camera.height) > LARGEST_SIDE:
        raise InputError(f"a picture has sides of at most {LARGEST_SIDE} pixels")
    if mode in ("heat", "mask") and not answers:
        raise InputError(f"the picture {mode!r} needs a text")
    if answers and len(colors) != len(answers):
        raise InputError(f"expected {len(answers)} colors, got {len(colors)}")
    if mode == "codes":
        return drawing(view.field, "codes", level, plain=True)(view)
    n_pixels = view.camera.width * view.camera.height
    if mode != "color" and n_pixels * (len(answers) + 4) > MOST_FOR_TEXTS:
        texts = counted(len(answers), "text")
        raise InputError(
            f"a picture of {n_pixels:,} pixels is too large for {texts}; use fewer texts or pixels"
        )
    rgb = view.renders.colors().cpu()
    if mode == "color":
        return as_picture(rgb)
    # Answers from a warm cache round differently; the picture must not depend on earlier questions.
    view.cache.clear()
    shown = view.show(answers)
    if mode == "heat" and len(shown) == 1:
        return heat_overlay(shown[0].heat, rgb, opacity=opacity)
    heats, masks = [answer.heat for answer in shown], [answer.mask for answer in shown]
    return texts_overlay(heats, masks, rgb, colors, opacity, mode == "heat")


def what_is_at(
    view: FieldView, confidence: Tensor, pixel: tuple[int, int], words: TextVectors | None
) -> dict[str, Any]:
    """Return the words that fit best at a pixel (x, y), level by level, and its position in the world.

    The codes of the Gaussians that contribute to the pixel are summed by their blending weights, as a render of codes
    does (method.md, stage 3). The position is on the pixel's ray, at the median depth of that weight.

    Returns:
        "position": [3] world units, None if nothing is there; "distance": from the camera; "levels": of each level its
        name, confidence 0..1, and words with relevancy, best first; levels without a code there have no words.
    """
    field, camera, (x, y) = view.field, view.camera, pixel
    if not (0 <= x < camera.width and 0 <= y < camera.height):
        raise InputError(f"pixel ({x}, {y}) is not in a view of {camera.width} x {camera.height}")
    # Of the whole view: Inria's rasteriser clamps its Jacobian at the edges, so a view of one pixel looks different.
    labels = torch.full((1, camera.height, camera.width), -1, dtype=torch.int32)
    labels[0, y, x] = 0
    sums = raster.region_sums(view.projection, labels.to(field.codebook.device))
    gaussians, _, weights = sums.triplets(0)
    if not len(gaussians) or not float(weights.sum()) > 0:
        return {"position": None, "distance": None, "levels": []}
    shares = weights.double().cpu()
    position = view.position_at(pixel, gaussians, shares)
    levels = []
    for level, name in enumerate(field.levels):
        embedding = _mean_embedding(field, level, gaussians, weights)
        sure = confidence[gaussians.cpu(), level]
        coded_shares = shares * (sure > 0)
        mean_confidence = (
            float((coded_shares * sure).sum() / coded_shares.sum()) if float(coded_shares.sum()) > 0 else 0.0
        )
        nearest = [] if words is None or not mean_confidence else _nearest_words(embedding, words)
        levels.append({"level": name, "confidence": round(mean_confidence, 4), "words": nearest})
    distance = float((position - camera.position).norm())
    return {"position": position.tolist(), "distance": distance, "levels": levels}


def _nearest_words(embedding: Tensor, words: TextVectors) -> list[dict[str, Any]]:
    """Return the words that fit an embedding [D] best, with their relevancy."""
    unit = torch.nn.functional.normalize(embedding, dim=0)
    cosines = words.queries.float().cpu() @ unit
    canonical = words.canonical.float().cpu() @ unit
    values = relevancy(cosines[None], canonical[None])[0]
    best = values.argsort(descending=True, stable=True)[:_WORDS_SHOWN].tolist()
    return [{"text": words.texts[row], "relevancy": round(float(values[row]), 4)} for row in best]


def _mean_embedding(field: Field, level: int, gaussians: Tensor, weights: Tensor) -> Tensor:
    """Return the sum of the decoded codes of Gaussians [M] by weights [M] at one level, [D] on the CPU."""
    # On the CPU: indexed sums on a GPU are not deterministic.
    indices = signed(field.code_indices)[:, level].index_select(0, gaussians)
    atoms = indices.view(field.code_indices.dtype).cpu().long()
    shares = (field.code_weights[:, level].index_select(0, gaussians).float() * weights[:, None]).cpu()
    code = torch.bincount(atoms.flatten(), shares.flatten().double(), field.n_atoms)
    return code.float() @ field.codebook[level].cpu()
