"""Edits of a scene: selections kept, removed, recoloured and faded; a picture of them, and the rows to write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup import raster
from scoup.base import InputError, counted, spread
from scoup.field import Field
from scoup.io import PlyTable, save_gaussians, splat_source
from scoup.pictures import Picture, as_picture, contact_sheet, mask_overlay
from scoup.query.field_view import FieldView
from scoup.scene import SH_C0, Camera, Gaussians

Edit = Literal["keep", "remove", "recolor", "fade"]
MOST_TRIED = 12  # cameras from which the one that sees most of a selection is chosen
TRIED_SIDE = 160  # pixels of their longer side
COVERED = 0.5  # share of a pixel's light from which it belongs to the selection
STATE = "state"
"""Property of uint8 flags that SuperSplat reads: 1 selected, 2 locked, 4 deleted."""


def edited(
    gaussians: Gaussians,
    mask: Tensor,
    edit: Edit,
    color: tuple[float, float, float] = (1.0, 0.36, 0.16),
    opacity: float = 0.15,
) -> Gaussians:
    """Edit the Gaussians in a selection [N] boolean.

    "keep" keeps only the selection, "remove" all others; "recolor" gives the selection a ``color`` (red, green, blue, 0
    to 1), with its light and shade as far as they do not depend on the direction of view; "fade" scales its opacities
    by ``opacity``, 0 to 1.
    """
    if not 0 <= opacity <= 1 or not all(0 <= value <= 1 for value in color):
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
    """Return a colour with the lightness of colours [M, 3] relative to their median."""
    lightness = rgb.clamp(0, 1).mean(1)
    usual = lightness.median().clamp(min=0.05) if len(lightness) else lightness.new_ones(())
    share = (lightness / usual).clamp(0.25, 1.75)[:, None]
    return (rgb.new_tensor(color) * share).clamp(0, 1)


def best_camera(field: Field, mask: Tensor, cameras: Sequence[Camera]) -> Camera:
    """Return the camera in which a selection [N] takes the largest share, of at most ``MOST_TRIED``, evenly spread."""
    if not cameras:
        raise InputError("no camera to draw a picture with; pass at least one")
    shares: list[tuple[float, Camera]] = []
    for camera in spread(cameras, MOST_TRIED):
        scale = min(1.0, TRIED_SIDE / max(camera.width, camera.height))
        shares.append((float(FieldView(field, camera, scale).shares(mask)[0].mean()), camera))
    return max(shares, key=lambda pair: pair[0])[1]


@dataclass(frozen=True, eq=False)
class SceneEdit:
    """An edit of the Gaussians of a field in a selection; "state" marks them for SuperSplat, and changes nothing."""

    field: Field
    mask: Tensor  # [N] boolean
    edit: Edit | Literal["state"]
    color: tuple[float, float, float]
    opacity: float

    @cached_property
    def left(self) -> Gaussians:
        """The Gaussians afterwards."""
        if self.edit == "state":
            return self.field.gaussians
        return edited(self.field.gaussians, self.mask, self.edit, self.color, self.opacity)

    def picture(self, cameras: Sequence[Camera], title: str) -> Picture:
        """Draw before, selection and after beside each other in the ``best_camera``, [H, W, 3] uint8."""
        after, preset = self.left, self.field.raster_preset
        camera = best_camera(self.field, self.mask, cameras)
        view = FieldView(self.field, camera)
        before = view.renders.colors().cpu()
        inside = view.shares(self.mask)[0].cpu() > COVERED
        later = torch.zeros(camera.height, camera.width, 3)
        if len(after):
            later = raster.render_colors(after, camera, raster.project(after, camera, preset)).cpu()
        tiles = [as_picture(before), mask_overlay(inside, before), as_picture(later)]
        heading = f"{title}: {int(self.mask.sum()):,} of {counted(len(self.mask), 'Gaussian')}"
        return contact_sheet(tiles, ("before", "selected", "after"), 3, 1500, heading)

    def save(self, path: Path, splat: Path | None = None, overwrite: bool = False) -> int:
        """Write what is left, a splat or a field (.scoup); return its number of Gaussians. ``copies_rows`` is of the
        file of ``splat``, by default the one the field names."""
        mask, left = {"keep": self.mask, "remove": ~self.mask}.get(self.edit), self.left
        if self.copies_rows(path):
            rows = SplatTable.of(self.field, splat)
            if self.edit == "state":
                table = rows.with_column(STATE, self.mask.byte())
            else:
                table = rows.edited(self.mask, left) if mask is None else rows.select(mask)
            table.write(path, overwrite)
            return len(table)
        if path.suffix.lower() == ".scoup":
            field = self.field.with_gaussians(left) if mask is None else self.field[mask]
            field.save(path, overwrite)
        else:
            save_gaussians(left.to("cpu"), path, overwrite)
        return len(left)

    @staticmethod
    def copies_rows(path: Path) -> bool:
        """Return whether a file of this name is a PLY with the rows and columns of the splat."""
        return path.suffix.lower() == ".ply" and not path.name.lower().endswith(".compressed.ply")


@dataclass(frozen=True, eq=False)
class SplatTable:
    """The PLY rows of a splat, and which of them are the N Gaussians of a field."""

    table: PlyTable  # M rows
    is_gaussian: Tensor  # [M] boolean, true N times; false for rows that are not finite

    @classmethod
    def of(cls, field: Field, geometry: Path | None = None) -> SplatTable:
        """Read the PLY the field was built on, by default the file it names, or make rows of its Gaussians if it was
        built on another one."""
        path = geometry or field.geometry_path
        try:
            path = None if path is None else splat_source(path).path
            if path is not None and path.suffix.lower() == ".ply":
                table = PlyTable.read(path)
                gaussians, is_gaussian = table.gaussians()
                if gaussians.fingerprint() == field.fingerprint:
                    return cls(table, torch.from_numpy(is_gaussian))
        except InputError:
            pass  # compressed, so its rows cannot be copied; or missing, and the field has its geometry embedded
        return cls(PlyTable.of(field.gaussians.to("cpu")), torch.ones(len(field), dtype=torch.bool))

    def select(self, mask: Tensor) -> PlyTable:
        """Return the rows of the Gaussians in ``mask`` [N] boolean."""
        return self.table.select(self._of_rows(mask))

    def edited(self, mask: Tensor, gaussians: Gaussians) -> PlyTable:
        """Return all rows, those in ``mask`` [N] boolean with the colours and opacities of ``gaussians`` (N)."""
        chosen = gaussians.select(mask.to(gaussians.device)).to("cpu")
        values, rows, changed = PlyTable.of(chosen), self._of_rows(mask), self.table.rows.copy()
        for name in values.names:
            if name == "opacity" or name.startswith(("f_dc_", "f_rest_")):
                changed[name][rows] = values.rows[name]
        return replace(self.table, rows=changed)

    def with_column(self, name: str, values: Tensor, missing: int = 0) -> PlyTable:
        """Return all rows with an integer property: ``values`` [N] of the Gaussians, ``missing`` for other rows."""
        return self.table.with_column(name, self._of_rows(values, missing))

    def _of_rows(self, values: Tensor, missing: int = 0) -> NDArray[Any]:
        column = torch.full((len(self.is_gaussian),), missing, dtype=values.dtype)
        column[self.is_gaussian] = values
        return column.numpy()
