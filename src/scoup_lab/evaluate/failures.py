"""Failure sheets: the worst answers of a scene as pictures, so that nobody is misled by a mean."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from scoup.pictures import Picture, contact_sheet, heat_map, mask_overlay
from scoup.query import LanguageField
from scoup.raster import render_colors
from scoup_lab.evaluate.pixel_report import query_records
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.relevancy_maps import localize, segment
from scoup_lab.evaluate.rules import MaskRule
from scoup_lab.evaluate.scores import PairScore, SceneScore

TRUTH_COLOR = (70, 200, 110)
MOST = 6  # queries on a sheet


def worst_pairs(score: SceneScore) -> list[PairScore]:
    """Return the worst answered pair of each of the worst queries (by mean IoU), worst query first; ties by name."""
    by_label = score.by_label()
    ranked = [by_label[record["query"]] for record in query_records(score)[:MOST]]
    return [min(pairs, key=lambda pair: (pair.iou, pair.frame)) for pairs in ranked]


def failure_sheet(
    score: SceneScore,
    scene: LabelledScene,
    field: LanguageField,
    maps: Callable[[PairScore], Tensor],
    rule: MaskRule,
) -> Picture:
    """Return rows of truth, relevancy and mask for the worst queries of a scene.

    ``maps``: gives the relevancy [S, H, W] of a pair.
    """
    rows = scene.protocol.rows(field.levels)
    frames = {frame.name: (frame, camera) for frame, camera in scene.frames}
    tiles: list[Picture] = []
    worst = worst_pairs(score)
    for pair in worst:
        relevancy = maps(pair)[rows]
        height, width = relevancy.shape[1:]
        frame, camera = frames[pair.frame]
        rgb = render_colors(field.gaussians, camera.resized(width, height)).cpu()
        truth = frame.resized(width, height)
        answer = segment(relevancy, rule)
        point = localize(relevancy, rule).pixel if pair.hit is not None else None
        box = truth.boxes.get(pair.label)
        # Of several boxes none: one alone would mislead.
        corners = None if box is None or len(box) > 1 else (*box[0, :2].tolist(), *(box[0, 2:] + 1).tolist())
        name, remark = f'"{pair.label}"', f"truth, {pair.frame}"
        level = field.levels[rows[answer.level]]
        tiles += [
            mask_overlay(truth.masks[pair.label], rgb, corners, None, name, remark, TRUTH_COLOR),
            heat_map(relevancy[answer.level], rgb, "relevancy", level, answer.score),
            mask_overlay(answer.mask, rgb, None, point, "found", f"IoU {pair.iou:.2f}"),
        ]
    heading = f"{score.scene}: the worst {len(worst)} of {len(score.by_label())} queries; scene mIoU {score.miou:.2f}"
    footer = f"Protocol: {score.protocol}. Each query in the frame answered worst."
    return contact_sheet(tiles, columns=3, width=1200, heading=heading, footer=footer)
