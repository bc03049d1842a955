"""The word of several that fits each Gaussian best: in the scene, in views, and as files for other programs
(docs/editing.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from torch import Tensor

from scoup import raster
from scoup.base import (
    InputError,
    Progress,
    UnknownNameError,
    as_json,
    atomic_file,
    no_progress,
    spread,
    unique_slugs,
    write_text,
)
from scoup.field import NO_THING, Field
from scoup.io import PlyTable, UsdThing, save_png, write_usd
from scoup.pictures import Picture, contact_sheet, label_colors, region_overlay, swatch_legend
from scoup.query.answer import Answer
from scoup.query.answer_files import mask_files
from scoup.query.boxes import PointSets
from scoup.query.coco import CocoAnnotations
from scoup.query.edits import SplatTable, edited
from scoup.query.field_view import FieldView
from scoup.query.votes import true_rows
from scoup.scene import SH_C0, Camera, Gaussians

NONE = -1
"""The id of a Gaussian that no word fits."""
NONE_NAME = "none"
AT_A_TIME = 16  # words rendered together
LEAST_ALPHA = 0.5  # of a pixel with a label
COLUMNS, SHEET_WIDTH = 3, 1500
MOST_VIEWS = 6  # on a sheet
SIDECAR = ("labels.npy", "labels.json")
IDS, COLORS, GLB, USD = "labels.ply", "colored.ply", "labels.glb", "labels.usdc"
CLOUDS, MAPS, COCO, SHEET = "clouds", "maps", "maps/coco.json", "labels.png"
PROPERTY, INSTANCE = "label", "thing"
GREY = 0.35  # of Gaussians without a word


@dataclass(frozen=True, eq=False, repr=False)
class GaussianLabels:
    """The class of every Gaussian. Tensors are on the CPU.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> labels = field.label(field.question(["kettle", "wooden table"], always=True))
        >>> labels.names
        ('kettle', 'wooden table')
    """

    ids: Tensor
    """[N] int32, the position of a word in ``names``; -1 for none of them."""
    answers: tuple[Answer, ...]
    """The answer to each of Q words."""
    instances: Tensor
    """[N] int32, which of these things it belongs to; -1 without a word, and where the votes answer."""

    @classmethod
    def of(cls, field: Field, answers: Sequence[Answer]) -> GaussianLabels:
        """Return the word that fits each Gaussian best, or "none", from the answers to the words; repeated words count
        once.

        A word applies to the Gaussians that answer it. Of several words for one Gaussian, the one answered by the
        finest level counts, for the name of a part says more than that of its whole; of words of one level the one with
        the largest score.
        """
        of_name: dict[str, Answer] = {}
        for answer in answers:
            of_name.setdefault(answer.word, answer)
        answers = [*of_name.values()]
        if NONE_NAME in of_name:
            raise InputError(f"labels need words that differ from {NONE_NAME!r} (got {', '.join(of_name)})")
        ids = labels_of_answers(answers, field.levels)
        instances = torch.full_like(ids, NO_THING)
        for number, answer in enumerate(answers):
            if answer.things and field.thing_table is not None:
                owners = field.thing_table.owners.cpu()
                inside = torch.isin(owners, torch.tensor(answer.things, dtype=owners.dtype))
                instances = torch.where(
                    ids == number, torch.where(inside, owners, NO_THING).amax(1), instances
                )
        return cls(ids, tuple(answers), instances)

    @property
    def names(self) -> tuple[str, ...]:
        """The Q words."""
        return tuple(answer.word for answer in self.answers)

    def __repr__(self) -> str:
        counts = ", ".join(f"{name}: {count:,}" for name, count in self.counts().items())
        return f"GaussianLabels({len(self.ids):,} Gaussians; {counts})"

    def mask(self, name: str) -> Tensor:
        """Return the Gaussians of a word, or of "none", [N] boolean.

        Raises:
            UnknownNameError: it is another word.
        """
        if name in self.names:
            return self.ids == self.names.index(name)
        if name == NONE_NAME:
            return self.ids == NONE
        raise UnknownNameError("class", name, (*self.names, NONE_NAME))

    def counts(self) -> dict[str, int]:
        """Return the number of Gaussians per word, and of "none"."""
        counts = torch.bincount(self.ids.long() + 1, minlength=len(self.names) + 1).tolist()
        return {**dict(zip(self.names, counts[1:], strict=True)), NONE_NAME: counts[0]}

    def to_dict(self) -> dict[str, Any]:
        """Return the meaning of the numbers as plain JSON values, as in ``labels.json`` (docs/editing.md)."""
        counts, colors = self.counts(), label_colors(len(self.names)).tolist()
        classes = [
            {
                "id": number,
                "name": answer.word,
                "color": colors[number],
                "gaussians": counts[answer.word],
                "level": answer.level,
                "things": list(answer.things),
                "present": answer.presence,
                "score": answer.verdict()["score"],
            }
            for number, answer in enumerate(self.answers)
        ]
        none = {"id": NONE, "name": NONE_NAME, "gaussians": counts[NONE_NAME]}
        return {"gaussians": len(self.ids), "classes": classes, "none": none}


def labels_of_answers(answers: Sequence[Answer], levels: Sequence[str]) -> Tensor:
    """Return the number of the word of each Gaussian, [N] int32, ``NONE`` for none."""
    ids = torch.full((len(answers[0].mask),), NONE, dtype=torch.int32)
    # The best word comes last and overwrites the others; of equals the first word wins.
    order = sorted(
        range(len(answers)),
        key=lambda number: (-levels.index(answers[number].level), answers[number].score or 0.0, -number),
    )
    for number in order:
        ids[answers[number].mask] = number
    return ids


def label_map(view: FieldView, labels: GaussianLabels) -> Tensor:
    """Return the word whose Gaussians contribute most to each pixel, [H, W] int32 on the CPU; ``NONE`` where Gaussians
    without a word do, or where alpha is below ``LEAST_ALPHA``.
    """
    ids = labels.ids.to(view.field.codebook.device)
    numbers = torch.arange(NONE, len(labels.names), device=ids.device, dtype=ids.dtype)
    shape = view.camera.height, view.camera.width
    most, painted = torch.full(shape, -1.0, device=ids.device), torch.zeros(shape, device=ids.device)
    given = torch.full(shape, NONE, device=ids.device, dtype=ids.dtype)
    for batch in numbers.split(AT_A_TIME):
        image, painted = raster.render_channels(view.projection, (ids[:, None] == batch).float())
        largest, places = image.max(2)
        given = torch.where(largest > most, batch[places], given)
        most = torch.maximum(largest, most)
    return torch.where(painted >= LEAST_ALPHA, given, NONE).int().cpu()


def label_sheet(labels: GaussianLabels, views: Mapping[str, Picture]) -> Picture:
    """Draw views by their names, each the ``region_overlay`` of its ``label_map``, over a legend of the words."""
    sheet = contact_sheet([*views.values()], [*views], COLUMNS, SHEET_WIDTH)
    counts, colors = labels.counts(), label_colors(len(labels.names))
    order = sorted(enumerate(labels.names), key=lambda word: -counts[word[1]])
    used = [(number, name) for number, name in order if counts[name]]
    return swatch_legend(
        sheet,
        f"Labels of {len(labels.ids):,} Gaussians; grey: {NONE_NAME} of the words ({counts[NONE_NAME]:,}).",
        "words",
        [tuple(colors[number].tolist()) for number, _ in used],
        [name for _, name in used],
    )


class LabelFiles:
    """The files of labels, for other programs.

    Args:
        words: of the labels, each once.
        outputs: the wanted of "sidecar", "ids", "colors", "glb", "usd", "clouds", "maps", "masks" and "sheet".
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
        """Write the files into an empty folder, made if it is missing; return the cameras that see no coded Gaussian.
        ``geometry`` is the file of the splat, by default the one the field names."""
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
                coco.add(camera.name, masks)
            if binary:
                save_png(words >= 0, folder / self._masks[number])
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


def save_label_png(numbers: Tensor, colors: np.ndarray, path: Path) -> None:
    """Write a ``label_map`` of words with ``colors`` [C, 3] uint8 as a PNG whose pixel values are the numbers plus one.

    Up to 255 words it has a palette, so that it shows in colours; more make a grey picture of 16 bits.
    """
    if len(colors) > 65535:
        raise InputError(f"{path}: a map has at most 65535 words, got {len(colors)}")
    values = (numbers + 1).numpy()
    picture = Image.fromarray(values.astype(np.uint16 if len(colors) > 255 else np.uint8))
    if len(colors) <= 255:
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
