"""Labels of Gaussians in views: maps of numbers, and pictures of them."""

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
LEAST_ALPHA = 0.5  # of a pixel with a label
COLUMNS, SHEET_WIDTH = 3, 1500
MOST_VIEWS = 6  # on a sheet


def label_map(field: CodedScene, projection: raster.Projection, labels: GaussianLabels) -> Tensor:
    """Return the word whose Gaussians contribute most to each pixel, [H, W] int32 on the CPU; ``NONE`` where Gaussians
    without a word do, or where alpha is below ``LEAST_ALPHA``.
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
    return torch.where(painted >= LEAST_ALPHA, given, NONE).int().cpu()


class LabelSheet:
    """Views with their label maps beside each other, over a legend of the words."""

    def __init__(self, labels: GaussianLabels) -> None:
        self._labels = labels
        self._tiles: list[Picture] = []
        self._names: list[str] = []

    def add(self, view: str, numbers: Tensor, rgb: Tensor) -> None:
        """Add a view by its name, its ``label_map`` and its colours [H, W, 3] float 0..1."""
        self._tiles.append(region_overlay(numbers, rgb))
        self._names.append(view)

    def picture(self) -> Picture:
        """Draw the sheet, [H, W, 3] uint8."""
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
