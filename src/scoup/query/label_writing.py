"""Labels of Gaussians as files for other programs (docs/editing.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from scoup.base import (
    InputError,
    Progress,
    as_json,
    atomic_file,
    no_progress,
    spread,
    unique_slugs,
    write_text,
)
from scoup.field import Field
from scoup.io import PlyTable, UsdThing, save_png, write_usd
from scoup.pictures import Picture, label_colors, region_overlay
from scoup.query.answer_files import mask_files
from scoup.query.boxes import PointSets
from scoup.query.coco import CocoAnnotations
from scoup.query.edits import SplatTable, edited
from scoup.query.field_view import FieldView
from scoup.query.labels import MOST_VIEWS, NONE, NONE_NAME, GaussianLabels, label_map, label_sheet
from scoup.query.votes import true_rows
from scoup.scene import SH_C0, Camera, Gaussians

LabelOutput = Literal["sidecar", "ids", "colors", "glb", "usd", "clouds", "maps", "masks", "sheet"]
SIDECAR = ("labels.npy", "labels.json")
IDS, COLORS, GLB, USD = "labels.ply", "colored.ply", "labels.glb", "labels.usdc"
CLOUDS, MAPS, COCO, SHEET = "clouds", "maps", "maps/coco.json", "labels.png"
PROPERTY, INSTANCE = "label", "thing"
GREY = 0.35  # of Gaussians without a word


class LabelFiles:
    """The files of labels, for other programs.

    Args:
        words: of the labels, each once.
        outputs: which of ``LabelOutput`` are wanted.
        cameras: of "maps" and "sheet"; a sheet alone takes some of them.
    """

    def __init__(self, words: Sequence[str], outputs: Sequence[str], cameras: Sequence[Camera] = ()) -> None:
        names = [*words, NONE_NAME]
        self._clouds = {
            name: f"{CLOUDS}/{slug}.ply" for name, slug in zip(names, unique_slugs(names), strict=True)
        }
        self._masks = mask_files(cameras)
        self._maps = [f"{MAPS}/{slug}.png" for slug in unique_slugs(camera.stem for camera in cameras)]
        self._outputs, self._cameras = outputs, cameras
        of = {
            "sidecar": list(SIDECAR),
            "ids": [IDS],
            "colors": [COLORS],
            "glb": [GLB],
            "usd": [USD],
            "clouds": [*self._clouds.values()],
            "maps": [COCO, *self._maps],
            "masks": self._masks,
            "sheet": [SHEET],
        }
        # Of all files, within their folder.
        self.names = [name for output in outputs for name in of[output]]

    def write(
        self,
        field: Field,
        labels: GaussianLabels,
        folder: Path,
        geometry: Path | None = None,
        progress: Progress = no_progress,
    ) -> list[Camera]:
        """Write the files into an empty folder; return the cameras that see no coded Gaussian.

        Args:
            field: that was labelled, with its geometry.
            labels: of its Gaussians.
            folder: created if missing.
            geometry: file of the splat; by default the one the field names.
            progress: called after each view.
        """
        gaussians, outputs = field.gaussians.to("cpu"), self._outputs
        folder.mkdir(parents=True, exist_ok=True)
        if "sidecar" in outputs:
            with atomic_file(folder / SIDECAR[0]) as stream:
                np.lib.format.write_array(stream, labels.ids.numpy().astype(np.int32), allow_pickle=False)
            record = labels.to_dict() | {"frame": field.world.to_dict()}
            write_text(folder / SIDECAR[1], as_json(record) + "\n")
        if "ids" in outputs:
            rows = SplatTable.of(field, geometry)
            for name, numbers in ((PROPERTY, labels.ids), (INSTANCE, labels.instances)):
                rows = replace(rows, table=rows.with_column(name, numbers, NONE))
            rows.table.write(folder / IDS)
        if "colors" in outputs:
            PlyTable.of(labelled_colors(gaussians, labels)).write(folder / COLORS)
        if "glb" in outputs:
            from scoup.io import write_gltf

            write_gltf(gaussians, folder / GLB, ids=labels.ids, names=labels.names)
        if "usd" in outputs:
            write_usd(gaussians, folder / USD, things=usd_things(field, labels))
        for name, file in self._clouds.items() if "clouds" in outputs else ():
            point_cloud(gaussians.select(labels.mask(name))).write(folder / file)
        return self._write_views(field, labels, folder, progress)

    def _write_views(
        self, field: Field, labels: GaussianLabels, folder: Path, progress: Progress
    ) -> list[Camera]:
        binary = "masks" in self._outputs
        maps, colors, cameras = "maps" in self._outputs, label_colors(len(labels.names)), self._cameras
        on_sheet = set(spread(range(len(cameras)), MOST_VIEWS)) if "sheet" in self._outputs else set()
        wanted = [number for number in range(len(cameras)) if maps or binary or number in on_sheet]
        coco, sheet, blind = CocoAnnotations(labels.names), dict[str, Picture](), []
        for done, number in enumerate(wanted, start=1):
            camera = cameras[number]
            view = FieldView(field, camera)
            if not view.is_visible():
                blind.append(camera)
            words = label_map(view, labels)
            if maps:
                save_label_png(words, colors, folder / self._maps[number])
                masks = [(words == word).numpy() for word in range(len(labels.names))]
                coco.add(camera.name, (camera.width, camera.height), masks)
            if binary:
                save_png(words.cpu() >= 0, folder / self._masks[number])
            if number in on_sheet:
                sheet[camera.name] = region_overlay(words, view.renders.colors().cpu())
            progress("label maps", done, len(wanted))
        if maps:
            coco.write(folder / COCO)
        if on_sheet:
            save_png(label_sheet(labels, sheet), folder / SHEET)
        return blind


def usd_things(field: Field, labels: GaussianLabels) -> list[UsdThing]:
    """Return the things of each word with their boxes; its Gaussians of none are one more, numbered beyond all."""
    beyond = 0 if field.thing_table is None else len(field.thing_table)
    pairs = torch.stack([labels.ids, labels.instances], 1)
    groups = pairs[labels.ids != NONE].unique(dim=0)
    members = [(pairs == group).all(1) for group in groups]
    points = PointSets.of(field.gaussians, [true_rows(mask) for mask in members])
    return [
        UsdThing(labels.names[word], beyond + word if thing < 0 else thing, mask, **vars(box))
        for (word, thing), mask, box in zip(groups.tolist(), members, points.boxes(field.up()), strict=True)
        if box is not None
    ]


def save_label_png(numbers: Tensor | np.ndarray, colors: np.ndarray, path: str | Path) -> None:
    """Write a map [H, W] of integers from -1 (none) as a PNG whose pixel values are the numbers plus one; 0 is none.

    Up to 255 numbers it has a palette, the ``colors`` [C, 3] uint8, so that it shows in colours; more make a grey
    picture of 16 bits.
    """
    array = numbers.cpu().numpy() if isinstance(numbers, Tensor) else np.asarray(numbers)
    count = len(colors)
    if array.ndim != 2 or not array.size or array.min() < -1 or array.max() >= count or count > 65535:
        raise InputError(f"{path}: a map of numbers is [H, W], each -1 to {count - 1}")
    if count > 255:
        picture = Image.fromarray((array + 1).astype(np.uint16))
    else:
        picture = Image.fromarray((array + 1).astype(np.uint8))
        picture.putpalette(np.concatenate([np.zeros((1, 3), np.uint8), colors]).tobytes())
    with atomic_file(path) as stream:
        picture.save(stream, format="PNG")


def labelled_colors(gaussians: Gaussians, labels: GaussianLabels) -> Gaussians:
    """Return the Gaussians in the colours of their words, grey without a word, with their own light and shade."""
    colors = torch.from_numpy(label_colors(len(labels.names)).copy()).double() / 255
    colored = edited(gaussians, labels.ids == NONE, "recolor", (GREY, GREY, GREY))
    for number, color in enumerate(colors.tolist()):
        colored = edited(colored, labels.ids == number, "recolor", (color[0], color[1], color[2]))
    return colored


def point_cloud(gaussians: Gaussians) -> PlyTable:
    """Return centres and colours of Gaussians as vertices of a PLY, for programs that only read point clouds."""
    kinds = [*((name, "<f4") for name in "xyz"), *((name, "u1") for name in ("red", "green", "blue"))]
    rows = np.zeros(len(gaussians), dtype=kinds)
    rgb = (gaussians.sh[:, 0] * SH_C0 + 0.5).clamp(0, 1).mul(255).round().byte().numpy()
    for column, name in enumerate("xyz"):
        rows[name] = gaussians.means[:, column].numpy()
    for column, name in enumerate(("red", "green", "blue")):
        rows[name] = rgb[:, column]
    return PlyTable(Path("<memory>"), rows)
