"""Views of somebody else's splat in every format: what is chosen, and how long it takes."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import torch

from benchmarks.data import data_folder
from benchmarks.study import Record, Study
from scoup.extract.own_views import choose_cameras, save_views
from scoup.io import load_gaussians, save_gaussians
from scoup.scene.gaussians import Gaussians
from scoup_lab.bench import markdown

NAME = "guitar"
FORMATS = (".ply", ".compressed.ply", ".splat", ".spz", ".glb", ".ksplat", ".sog")
SHIPPED = (".ply", ".compressed.ply")
"""Formats in which the splat came; the others are made by `scoup convert`."""


@dataclass(frozen=True, kw_only=True)
class Splats(Study):
    """Choose views of a splat that came without cameras and photographs, in every format, and of many of it in a row.

    The guitar is somebody else's scan: a PLY and a compressed PLY, from which the other files are made. Seconds are of
    the processor, of all threads together: those of the choice, which an interrupted command starts again, and those
    of the renders.
    """

    copies: int = 11
    """Guitars in the row, which together are a million Gaussians."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains guitar/."""

    rows_depend_on: ClassVar[tuple[str, ...]] = ("copies",)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        folder = self.data / NAME
        with tempfile.TemporaryDirectory(prefix="splats-") as made:
            for suffix in FORMATS:
                file = (folder if suffix in SHIPPED else Path(made)) / f"{NAME}{suffix}"
                if suffix in known:
                    continue
                if suffix not in SHIPPED:
                    save_gaussians(load_gaussians(folder / f"{NAME}.ply"), file)
                yield (
                    suffix,
                    {"bytes": file.stat().st_size, **_figures(load_gaussians(file), Path(made) / suffix[1:])},
                )
            if (row := f"{self.copies} in a row") not in known:
                many = _in_a_row(load_gaussians(folder / f"{NAME}.ply"), self.copies)
                yield row, _figures(many, Path(made) / "many")

    def line(self, figures: Any) -> str:
        return f"{figures['views']} views, {figures['choice']:.1f} + {figures['renders']:.1f} s"

    @staticmethod
    def table(record: Record) -> str:
        """Return one row per file; seconds as ratios to those of the PLY."""
        of_ply = record["rows"][".ply"]
        body = [
            [
                name,
                f"{row['gaussians']:,}",
                f"{row['bytes'] / 1e6:.1f}" if "bytes" in row else "",
                f"{row['views']}",
                f"{row['once']:.1%}",
                f"{row['often']:.1%}",
                *(f"{row[part] / of_ply[part]:.2f}" for part in ("choice", "renders")),
                f"{row['choice']:.0f}",
            ]
            for name, row in record["rows"].items()
        ]
        headers = [
            "guitar",
            "Gaussians",
            "MB",
            "views",
            "in one view",
            "in three",
            "choice, by PLY",
            "renders, by PLY",
        ]
        return markdown([*headers, "choice, CPU s"], body)


def _figures(gaussians: Gaussians, folder: Path) -> Record:
    """Return what `scoup views` chooses, and the seconds it takes."""
    cameras, choice = _timed(lambda: choose_cameras(gaussians))
    shown, renders = _timed(lambda: save_views(gaussians, cameras, folder))
    return {
        "gaussians": len(gaussians),
        "views": len(cameras),
        "once": shown.once,
        "often": shown.often,
        "choice": choice,
        "renders": renders,
    }


def _timed(work: Callable[[], Any]) -> tuple[Any, float]:
    before = time.process_time()
    return work(), time.process_time() - before


def _in_a_row(gaussians: Gaussians, count: int) -> Gaussians:
    """Return the splat several times, side by side."""
    low, high = torch.quantile(gaussians.means, torch.tensor([0.01, 0.99]), dim=0)
    step = torch.tensor([float(high[0] - low[0]) * 1.2, 0.0, 0.0])
    many = gaussians.select(torch.arange(len(gaussians)).repeat(count))
    places = torch.arange(count).repeat_interleave(len(gaussians))[:, None] * step
    return Gaussians(many.means + places, many.quats, many.scales, many.opacities, many.sh)
