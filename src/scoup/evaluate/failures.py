"""Failure sheets: the worst answers of a scene as pictures, so that nobody is misled by a mean."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from scoup.evaluate.scores import PairScore, SceneScore
from scoup.io.labels import LabelledFrame
from scoup.pictures import contact_sheet, heat_map, mask_overlay
from scoup.pictures.colors import ArrayOrTensor, Picture
from scoup.query.localize import localize
from scoup.query.presets import QueryPreset
from scoup.query.segment import segment

TRUTH_COLOR = (70, 200, 110)
MOST = 6  # queries on a sheet


def worst_pairs(score: SceneScore, count: int = MOST) -> list[PairScore]:
    """The worst answered pair of each of the worst queries (by mean IoU), worst query first; ties by name."""
    by_label: dict[str, list[PairScore]] = {}
    for pair in score.pairs:
        by_label.setdefault(pair.label, []).append(pair)
    ranked = sorted(
        by_label, key=lambda label: (sum(p.iou for p in by_label[label]) / len(by_label[label]), label)
    )
    return [min(by_label[label], key=lambda pair: (pair.iou, pair.frame)) for label in ranked[:count]]


def failure_sheet(
    score: SceneScore,
    frames: dict[str, LabelledFrame],
    maps: Callable[[PairScore], Tensor],
    color: Callable[[str, int, int], ArrayOrTensor],
    preset: QueryPreset,
    level_rows: tuple[int, ...],
    level_names: tuple[str, ...],
    note: str = "",
) -> Picture:
    """Rows of truth, relevancy and mask for the worst queries of a scene.

    Args:
        score: of the scene.
        frames: the truth by frame name.
        maps: gives the relevancy [S, H, W] of a pair.
        color: gives the colour render [H, W, 3] of a frame at (width, height).
        preset: by which masks were made.
        level_rows: positions of the levels that are asked, within the S.
        level_names: of all S levels.
        note: written below.
    """
    tiles: list[Picture] = []
    for pair in worst_pairs(score):
        relevancy = maps(pair)
        asked = relevancy[list(level_rows)]
        height, width = relevancy.shape[1:]
        rgb = color(pair.frame, width, height)
        truth = frames[pair.frame].resized(width, height)
        found = segment(asked, preset)
        point = localize(asked, preset).pixel if pair.hit is not None else None
        box = truth.boxes.get(pair.label)
        # Of several boxes none: one alone would mislead.
        corners = None if box is None or len(box) > 1 else (*box[0, :2].tolist(), *(box[0, 2:] + 1).tolist())
        tiles += [
            mask_overlay(
                truth.masks[pair.label],
                rgb,
                corners,
                None,
                f'"{pair.label}"',
                f"truth, {pair.frame}",
                TRUTH_COLOR,
            ),
            heat_map(asked[found.level], rgb, "relevancy", level_names[level_rows[found.level]], found.score),
            mask_overlay(found.mask, rgb, found.box, point, "found", f"IoU {pair.iou:.2f}"),
        ]
    heading = f"{score.scene}: the worst of {len({p.label for p in score.pairs})} queries; scene mIoU {score.miou:.2f}"
    footer = f"Protocol: {score.protocol}. Each query in the frame answered worst. {note}".strip()
    return contact_sheet(tiles, columns=3, width=1200, heading=heading, footer=footer)
