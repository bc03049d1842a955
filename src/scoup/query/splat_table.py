"""Selected Gaussians as rows of a 3DGS PLY, copied byte for byte where the field was built on one."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.io import PlyTable, gaussians_from_table, read_ply_table, splat_source
from scoup.io.splats.ply import table_from_gaussians
from scoup.query.coded_scene import CodedScene
from scoup.scene.gaussians import Gaussians


@dataclass(frozen=True, eq=False)
class SplatTable:
    """The PLY rows of a splat, and which of them are the N Gaussians of a field."""

    table: PlyTable  # M rows
    is_gaussian: Tensor  # [M] boolean, true N times; false for rows that are not finite

    @classmethod
    def of(cls, field: CodedScene, geometry: Path | None = None) -> SplatTable:
        """Read the PLY the field was built on, or make rows of its Gaussians if it was built on another file.

        Args:
            field: whose Gaussians are wanted.
            geometry: file of its splat; by default the one the field names.
        """
        path = geometry or field.geometry_path
        try:
            path = None if path is None else splat_source(path).path
            if path is not None and path.suffix.lower() == ".ply":
                table = read_ply_table(path)
                gaussians, kept = gaussians_from_table(table)
                if gaussians.fingerprint() == field.fingerprint:
                    return cls(table, torch.from_numpy(kept))
        except InputError:
            pass  # compressed, so its rows cannot be copied; or missing, and the field has its geometry embedded
        return cls(table_from_gaussians(field.gaussians.to("cpu")), torch.ones(len(field), dtype=torch.bool))

    def select(self, mask: Tensor) -> PlyTable:
        """Return the rows of the Gaussians in ``mask`` [N] boolean."""
        rows = torch.zeros(len(self.is_gaussian), dtype=torch.bool)
        rows[self.is_gaussian] = mask
        return self.table.select(rows.numpy())

    def edited(self, mask: Tensor, gaussians: Gaussians) -> PlyTable:
        """Return all rows, those in ``mask`` [N] boolean with the colours and opacities of ``gaussians`` (N)."""
        chosen = gaussians.select(mask.to(gaussians.device)).to("cpu")
        rows = torch.zeros(len(self.is_gaussian), dtype=torch.bool)
        rows[self.is_gaussian] = mask
        values = table_from_gaussians(chosen)
        changed = self.table.rows.copy()
        for name in values.names:
            if name == "opacity" or name.startswith(("f_dc_", "f_rest_")):
                changed[name][rows.numpy()] = values.rows[name]
        return replace(self.table, rows=changed)

    def with_column(self, name: str, values: Tensor, missing: int = 0) -> PlyTable:
        """Return all rows with an integer property: ``values`` [N] of the Gaussians, ``missing`` for other rows."""
        column = torch.full((len(self.is_gaussian),), missing, dtype=torch.int32)
        column[self.is_gaussian] = values.int()
        return self.table.with_column(name, column.numpy())

    def with_ids(self, masks: list[Tensor]) -> PlyTable:
        """Return all rows with a property `selected`: the number, from 1, of the last of ``masks`` [N] that contains
        the Gaussian; 0 for none.
        """
        ids = torch.zeros(int(self.is_gaussian.sum()), dtype=torch.int32)
        for number, mask in enumerate(masks, start=1):
            ids[mask] = number
        return self.with_column("selected", ids)
