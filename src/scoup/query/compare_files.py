"""The files of a comparison: JSON, pictures from before and after, and a page."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from scoup.base import Progress, counted, no_progress, staged, write_text
from scoup.field import Field
from scoup.pictures import Picture, as_picture
from scoup.query.catalog import PAGE, PICTURES, Card, cards_page, crop_window, cropped, viewing_cameras
from scoup.query.comparison import KINDS, Change, Comparison
from scoup.query.field_view import FieldView
from scoup.query.registration import Array, scale_of
from scoup.scene import Camera

RECORD = "compare.json"
SIDES = ("old", "new")
TITLES: dict[str, str] = {
    **{kind: kind.capitalize() for kind in KINDS},
    "unseen": "In one capture only, at a place that the other did not see",
}


def save_comparison(
    old: Field,
    new: Field,
    comparison: Comparison,
    folder: Path,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> list[str]:
    """Write the files of a comparison of two fields into a folder; return their names, but for those of pictures."""
    files = [RECORD, PAGE]
    with staged(folder, files, overwrite) as hidden:
        record = json.dumps(comparison.to_dict(), indent=1, allow_nan=False)
        write_text(hidden / RECORD, record + "\n")
        (hidden / PICTURES).mkdir()
        cards: dict[str, list[Card]] = {kind: [] for kind in KINDS}
        for number, change in enumerate(comparison.changes):
            progress("pictures", number, len(comparison.changes))
            names = {}
            for side, picture in _pictures(old, new, change, comparison):
                names[side] = f"{PICTURES}/{number:04d}_{side}.jpg"
                Image.fromarray(picture).save(hidden / names[side], quality=85)
            cards[change.kind].append(_card(change, names, comparison))
        progress("pictures", len(comparison.changes), len(comparison.changes))
        heading = " and ".join(field.path.name if field.path else "a field" for field in (old, new))
        count = counted(len(comparison.changes) - len(cards["unseen"]), "change")
        sections = {f"{title} ({len(cards[kind])})": cards[kind] for kind, title in TITLES.items()}
        count = f"{count}; {comparison.registration.describe()}"
        content = cards_page(f"Changes between {heading}", count, sections, pairs=True)
        write_text(hidden / PAGE, content)
    return files


def _card(change: Change, pictures: Mapping[str, str], comparison: Comparison) -> Card:
    sides = zip(SIDES, (change.old, change.new), strict=True)
    there = [(side, thing) for side, thing in sides if thing is not None]
    _, thing = there[-1]
    facts = (
        f"{comparison.describe(change)}, confidence {change.confidence:.2f}",
        thing.world.lengths(thing.box.extent.tolist()),
        ", ".join(f"thing {thing.number} of the {side} capture" for side, thing in there),
    )
    return Card(thing, facts, dict(sorted(pictures.items(), reverse=True)))


def _pictures(
    old: Field, new: Field, change: Change, comparison: Comparison
) -> Iterator[tuple[str, Picture]]:
    """Yield the object before and after; where it is not there, its place from the same camera."""
    transform = comparison.registration.transform
    sides = (old, change.old, new, np.linalg.inv(transform)), (new, change.new, old, transform)
    for index, (field, thing, other, to_other) in enumerate(sides):
        if thing is None:
            continue
        for camera in viewing_cameras(thing, list(field.cameras or ())):
            view = FieldView(field, camera)
            mask = view.mask_of(thing.gaussians)
            window = crop_window(mask)
            if window is None:
                continue
            yield SIDES[index], cropped(as_picture(view.renders.colors().cpu()), window, mask)
            if change.kind != "moved":
                again = FieldView(other, _moved_camera(camera, to_other))
                yield SIDES[1 - index], cropped(as_picture(again.renders.colors().cpu()), window)
            break


def _moved_camera(camera: Camera, transform: Array) -> Camera:
    scale = scale_of(transform)
    return camera.moved(transform[:3, :3] / scale, transform[:3, 3] / scale, scale)
