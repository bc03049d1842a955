"""What fields of real models' regions answer: of chosen photographs, and of masks by few points."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean
from typing import Any, ClassVar

import scoup
from benchmarks.answer_scenes import with_splat
from benchmarks.data import data_folder
from benchmarks.drawn import answers_of, mask_ious
from benchmarks.real_scenes import RealScene
from benchmarks.study import Record, Study
from scoup.base import spread
from scoup.extract import choose_photographs, find_photographs
from scoup.models import with_everyday
from scoup.scene import Camera, Cameras
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.bench import markdown

POOLINGS = ("", "_all")  # of the embeddings: suffixes of the folders of regions
ALL_POINTS = "all_points"  # folders of regions by all points begin with it, the others with language_features
SEED = 2  # of the codebook


@dataclass(frozen=True, kw_only=True)
class Photographs(Study):
    """Score fields of chosen photographs, and of masks by few points, on scenes with real models.

    SCENES has folders like those of the real scenes: photographs, splat, regions, words and labels of held-out views.
    Captures dwell on a part of the camera's path, and some of their photographs are blurred (`blurred.json`): fields of
    all photographs, of those that `scoup extract` chooses, of a third of all, and of as many evenly spaced ones. Other
    scenes have two sets of masks of the same photographs: by the preset fast, and by all points of its grid. mIoU is
    that of `scoup query --always`, the mean of two poolings of the embeddings.
    """

    scenes: Path
    """Folder of the scenes."""
    captures: tuple[str, ...] = ("hall-51", "table-51")
    """Names of the captures."""
    points: tuple[str, ...] = ("desk", "hall-21")
    """Names of the scenes with two sets of masks."""
    data: Path = field(default_factory=data_folder)
    """Folder of desk, whose words are asked."""

    rows_depend_on: ClassVar[tuple[str, ...]] = ()

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for names, score in ((self.captures, self._capture), (self.points, self._points)):
            for name in names:
                if name not in known:
                    yield name, score(self.scenes / name)

    def line(self, figures: Any) -> str:
        return "  ".join(f"{name} {value:g}" for name, value in figures.items())

    def record(self, rows: dict[str, Any]) -> Record:
        """Return the rows of each kind of scenes with their means."""
        kinds = {"captures": self.captures, "points": self.points}
        found = {kind: {name: rows[name] for name in names} for kind, names in kinds.items() if names}
        for of in found.values():
            heads = next(iter(of.values()))
            of["mean"] = {head: round(mean(row[head] for row in of.values()), 3) for head in heads}
        return {"scenes": found}

    @staticmethod
    def table(record: Record) -> str:
        return "\n\n".join(
            markdown(
                ["scene", *of["mean"]],
                [[name, *(f"{value:g}" for value in row.values())] for name, row in of.items()],
            )
            for of in record["scenes"].values()
        )

    def _capture(self, folder: Path) -> Record:
        cameras = list(scoup.load_cameras(folder))
        blurred = set(json.loads((folder / "blurred.json").read_text()))
        row: Record = {"views": len(cameras), "blurred": round(len(blurred) / len(cameras), 3)}
        row["all, mIoU"] = self._miou(folder, cameras)
        photographs, splat = find_photographs(folder), folder / "point_cloud.splat"
        for prefix, count in (("", None), ("a third, ", len(cameras) // 3)):
            found = choose_photographs(folder, photographs, count, gaussians=splat)
            chosen = {item.path for item in found}
            if not prefix:
                share = sum(path.name in blurred for path in chosen) / len(chosen)
                row |= {"chosen": len(chosen), "blurred of the chosen": round(share, 3)}
            there = [camera for camera in cameras if camera.image_path in chosen]
            row[f"{prefix}chosen, mIoU"] = self._miou(folder, there)
            row[f"{prefix}even, mIoU"] = self._miou(folder, spread(cameras, len(chosen)))
        return row

    def _points(self, folder: Path) -> Record:
        cameras = scoup.load_cameras(folder)
        there = set(scoup.load_regions(folder / ALL_POINTS, cameras).view_names)
        both = [camera for camera in cameras if camera.name in there]
        return {
            "photographs": len(both),
            "all points, mIoU": self._miou(folder, both, ALL_POINTS),
            "fast, mIoU": self._miou(folder, both),
        }

    def _miou(self, folder: Path, views: Sequence[Camera], regions: str = "language_features") -> float:
        """Return the mIoU of the fields of some views: the poolings have the same masks."""
        cameras, found = Cameras(views), []
        scene = with_splat(RealScene.of_folder(folder, regions, self.data, cameras))
        asked = with_everyday(scene.canonical, scene.everyday)
        for pooling in POOLINGS:
            pooled = scoup.load_regions(folder / (regions + pooling), cameras)
            embeddings = [pooled.embeddings(level)[0] for level in pooled.levels]
            inputs = replace(scene, embeddings=embeddings).inputs()
            fitted = METHODS["sparse"].uplift(inputs, MethodSettings(SEED))
            found += [
                iou for iou, *_ in mask_ious(scene, answers_of(scene, fitted, tuple(scene.queries), asked))
            ]
        return round(mean(found), 3)
