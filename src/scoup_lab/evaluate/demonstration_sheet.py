"""The demo's contact sheet: query, truth, relevancy and mask."""

from __future__ import annotations

from scoup.pictures import Picture, contact_sheet, heat_map, mask_overlay
from scoup_lab.evaluate.demonstration import DemoResult, question_of, rows_by_name
from scoup_lab.evaluate.failures import TRUTH_COLOR
from scoup_lab.evaluate.scores import PairScore


def query_sheet(result: DemoResult) -> Picture:
    """Return rows of truth, relevancy and mask: some favourites, and the worst answer of all.

    Each name is shown in the view of its median score, not of its best.
    """
    pairs = [_median_pair(result, name) for name in names_to_show(result)]
    tiles = [tile for pair in pairs for tile in _row(result, pair)]
    score = result.score
    count = f"{len(score.pairs)} queries in held-out views"
    heading = f"{count}: mIoU {score.miou:.2f}, localisation {score.accuracy:.0%}"
    footer = (
        "Scene, regions and embeddings are simulated; the truth comes from the scene's geometry. "
        "Each name is shown in its view of median score. The last row is the worst answer of the run."
    )
    return contact_sheet(tiles, columns=3, width=1200, heading=heading, footer=footer)


def names_to_show(result: DemoResult) -> list[str]:
    """Return the layout's favourites that were queried (or the names of best score), then the name of worst score."""
    rows = rows_by_name(result)
    known = {row.name for row in rows}
    favourites = result.scene.layout.favourites
    chosen = [name for name in favourites if name in known] or [row.name for row in rows[:4]]
    worst = rows[-1].name
    return [name for name in chosen if name != worst] + [worst]


def _median_pair(result: DemoResult, name: str) -> PairScore:
    pairs = sorted(result.score.by_label()[name], key=lambda pair: pair.iou)
    return pairs[len(pairs) // 2]


def _row(result: DemoResult, pair: PairScore) -> tuple[Picture, Picture, Picture]:
    scene, field = result.scene, result.field
    camera = scene.held_out[pair.frame]
    view = field.at(camera)
    rgb = view.renders.colors()
    (answer,) = view.answer(question_of(scene, [pair.label]))
    truth = mask_overlay(
        scene.mask(camera.name, pair.label),
        rgb,
        label=f'"{pair.label}"',
        remark=f"truth, {pair.frame}",
        color=TRUTH_COLOR,
    )
    heat = heat_map(answer.heat, rgb, "relevancy", answer.level, answer.score)
    mask = mask_overlay(answer.mask, rgb, answer.box, answer.point, "found", f"IoU {pair.iou:.2f}")
    return truth, heat, mask
