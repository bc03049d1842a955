"""Selected Gaussians as rows of a PLY."""

from __future__ import annotations

from pathlib import Path

import torch

from query.conftest import Queried
from scoup.io import gaussians_from_table, read_ply_table, save_gaussians
from scoup.query.edits import SplatTable


def test_rows_are_those_of_the_splat(queried: Queried, tmp_path: Path) -> None:
    gaussians = queried.field.gaussians
    save_gaussians(gaussians, tmp_path / "a.ply")
    stored = read_ply_table(tmp_path / "a.ply")
    mask = torch.arange(len(gaussians)) % 3 == 0
    # The file holds rounded numbers, so it is not the geometry of this field: rows are made from the Gaussians.
    for rows in (SplatTable.of(queried.field), SplatTable.of(queried.field, tmp_path / "a.ply")):
        assert rows.is_gaussian.all()
        assert len(rows.table) == len(gaussians)
        chosen, _ = gaussians_from_table(rows.select(mask))
        assert torch.equal(chosen.means, gaussians.means[mask])
    rows = SplatTable(stored, torch.ones(len(gaussians), dtype=torch.bool))
    assert rows.select(mask).rows.tobytes() == stored.rows[mask.numpy()].tobytes()


def test_a_column_of_all_rows(queried: Queried) -> None:
    rows = SplatTable.of(queried.field)
    whole = SplatTable(rows.table, torch.arange(len(rows.table)) >= 2)  # the first two rows are no Gaussians
    column = whole.with_column("state", torch.ones(len(rows.table) - 2, dtype=torch.uint8), 4).rows["state"]
    assert column.dtype == "u1"
    assert column.tolist() == [4, 4, *[1] * (len(column) - 2)]
