"""The study of archives: its figures by hand, and a small run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("duckdb", reason="duckdb is not installed (pip install 'scoup[archive]')")
from benchmarks.archive import _figures, _ranking, _summary
from benchmarks.archive_scans import World
from benchmarks.embedding_kinds import KINDS


def test_ranking_by_hand() -> None:
    there = np.array([True, False, True])
    assert _ranking(np.array([3.0, 2.0, 1.0]), there) == [pytest.approx((1 + 2 / 3) / 2), 1.0]


@pytest.mark.data
def test_simulated_scans_are_told_apart(data_folder: Path) -> None:
    world = World.open(data_folder)
    first, scans = (world.simulate(KINDS["desk"], 6, seed=100) for _ in range(2))
    assert all(
        (one.table.embeddings == other.table.embeddings).all()
        for one, other in zip(first, scans, strict=True)
    )
    figures = _figures(world, scans)
    assert figures["AUC"]["own"] > figures["AUC"]["cosine"] > 0.5
    summary = _summary({"desk/100": figures})
    assert summary["own"]["AP"][0] > 0.6
    assert summary["own"]["place"][0] > summary["cosine"]["place"][0]
