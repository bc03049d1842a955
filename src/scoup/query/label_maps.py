"""The labels of Gaussians in the views of cameras: maps of numbers, and pictures of them."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup import raster
from scoup.pictures import contact_sheet, region_overlay, swatch_legend
from scoup.pictures.colors import Picture, label_colors
from scoup.pictures.lettering import stacked
from scoup.query.coded_scene import CodedScene
from scoup.query.label import NONE, NONE_NAME, GaussianLabels

AT_A_TIME = 16  # words rendered together
LEAST_PAINTED = 0.5  # share of a pixel's light from which it has a label at all
COLUMNS, SHEET_WIDTH = 3, 1500
MOST_VIEWS = 6  # on a sheet


def label_map(field: CodedScene, projection: raster.Projection, labels: GaussianLabels) -> Tensor:
    """[H, W] int32 on the CPU: at each pixel the word whose Gaussians paint most of it, ``NONE`` where those of none
    of the words do, or where less than half of the pixel is painted.

    All views show the same labels: they are looked up, not decided again in each.

    Args:
        field: that was labelled.
        projection: of its Gaussians to the camera.
        labels: from ``scoup.query.label.label``.
    """
    ids = labels.ids.to(field.codebook.device)
    numbers = torch.arange(NONE, len(labels.names), device=ids.device, dtype=ids.dtype)
    shape = projection.height, projection.width
    most, painted = torch.full(shape, -1.0, device=ids.device), torch.zeros(shape, device=ids.device)
    given = torch.full(shape, NONE, device=ids.device, dtype=ids.dtype)
    for part in numbers.split(AT_A_TIME):
        image, painted = raster.render_channels(projection, (ids[:, None] == part).float())
        found, places = image.max(2)
        given = torch.where(found > most, part[places], given)
        most = torch.maximum(found, most)
    return torch.where(painted >= LEAST_PAINTED, given, NONE).int().cpu()


class LabelSheet:
    """Takes views with their label maps and draws them beside each other, over a legend of the words.

    Args:
        labels: of the Gaussians.
    """

    def __init__(self, labels: GaussianLabels) -> None:
        self._labels = labels
        self._tiles: list[Picture] = []
        self._names: list[str] = []

    def add(self, view: str, numbers: Tensor, rgb: Tensor) -> None:
        """Add a view.

        Args:
            view: its name.
            numbers: [H, W] from ``label_map``.
            rgb: [H, W, 3] float 0..1.
        """
        self._tiles.append(region_overlay(numbers, rgb))
        self._names.append(view)

    def picture(self) -> Picture:
        """[H, W, 3] uint8."""
        sheet = contact_sheet(self._tiles, self._names, COLUMNS, SHEET_WIDTH)
        counts = self._labels.counts()
        order = sorted(range(len(self._labels.names)), key=lambda number: -counts[self._labels.names[number]])
        shown = [number for number in order if counts[self._labels.names[number]]]
        colors = label_colors(len(self._labels.names))
        legend = swatch_legend(
            sheet.shape[1],
            f"Labels of {len(self._labels.ids):,} Gaussians; grey: {NONE_NAME} of the words ({counts[NONE_NAME]:,}).",
            "words",
            [tuple(colors[number].tolist()) for number in shown],
            [self._labels.names[number] for number in shown],
        )
        return stacked([sheet, legend])
