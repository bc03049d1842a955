"""Fields from chosen cameras beside fields from the given ones, with the same number of views."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import mean
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from benchmarks.answer_scenes import SceneSize
from benchmarks.answers import difference_cell, score
from benchmarks.data import data_folder
from benchmarks.study import Record, Study
from benchmarks.view_scenes import DESK, NotObserved, ViewScene, make_view_scene
from benchmarks.ways import DRAWS, LAYOUTS, WAYS, groups_of
from scoup.base.errors import looked_up
from scoup.extract.own_views import OPAQUE, choose_cameras
from scoup.scene.cameras import Camera, Cameras
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.bench import markdown
from scoup_lab.evaluate.metrics import bootstrap_interval

Floats = NDArray[np.float64]
SCORES = ("always", "localisation")
RING_ANGLE, RING_RISE = 60.0, 30.0  # degrees: angle of view, and height of the ring above the middle


def given(scene: ViewScene) -> Cameras:
    """Return the cameras that came with the scene."""
    return scene.given


def given_half(scene: ViewScene) -> Cameras:
    """Return the half of the given cameras that stands on one side: they leave out a part."""
    places = _places(scene.given)
    along = (places - places.mean(0)) @ np.linalg.svd(places - places.mean(0))[2][0]
    kept = np.argsort(along, kind="stable")[: len(along) // 2]
    return scene.given.select(sorted(kept.tolist()))


def own(scene: ViewScene) -> Cameras:
    """Return as many chosen cameras as were given."""
    return _chosen(scene, len(scene.given))


def half_beside(scene: ViewScene) -> Cameras:
    """Return "given-half" and chosen cameras beside them, together as many as were given."""
    there = given_half(scene)
    return Cameras((*there, *_chosen(scene, len(scene.given) - len(there), there)))


def own_number(scene: ViewScene) -> Cameras:
    """Return as many chosen cameras as the choice itself decides."""
    return _chosen(scene, None)


def ring(scene: ViewScene) -> Cameras:
    """Return cameras on a circle around the splat, as for a turntable."""
    means = scene.gaussians.means[scene.gaussians.opacities >= OPAQUE].double().numpy()
    middle = np.median(means, 0)
    radius = float(np.quantile(np.linalg.norm(means - middle, axis=1), 0.9))
    up, width = _up(scene.given), scene.given[0].width
    first = np.linalg.svd(up[None])[2][1]
    second = np.cross(up, first)
    away, rise = radius / np.sin(np.radians(RING_ANGLE / 2)), np.radians(RING_RISE)
    eyes = [
        middle + away * (np.cos(rise) * (np.cos(turn) * first + np.sin(turn) * second) + np.sin(rise) * up)
        for turn in 2 * np.pi * np.arange(len(scene.given)) / len(scene.given)
    ]
    focal = width / 2 / np.tan(np.radians(RING_ANGLE / 2))
    return _looking(scene, [(eye, middle) for eye in eyes], focal, up)


CHOICES: dict[str, Callable[[ViewScene], Cameras]] = {
    "photographs": given,
    "given": given,
    "own": own,
    "ring": ring,
    "given-half": given_half,
    "half-beside": half_beside,
    "own-number": own_number,
}
"""By name; "photographs" are the given cameras of the real scene, whose regions are of photographs, not of renders."""
COMPARED = (
    ("own", "given"),
    ("own", "ring"),
    ("half-beside", "given-half"),
    ("given", "photographs"),
)


@dataclass(frozen=True, kw_only=True)
class Views(Study):
    """Build fields from cameras chosen for the bare splat, from the given cameras and from baselines.

    All are asked in the labelled views of the scene, which no field is built from, and scored by the same rules: mIoU
    of `scoup query --always`, and localisation by the protocol of LERF-OVS. "given" and "own" have the same number of
    views. In "given-half" the given cameras stand on one side and leave out a part; "half-beside" adds as many chosen
    ones as were left out. "own-number" has as many views as `scoup views` decides; "ring" puts the cameras around the
    splat.

    Masks and embeddings are simulated from the truth at the cameras, and so do not suffer where a splat looks bad from
    there; but on desk they are of real models. There "photographs" are the given ones, and all other rows are of
    renders, so that the loss by rendering is "given - photographs". Tuned on table-0, shelves-0, hall-0, yard-0 and
    draws 1 to 3 of the kitchen; renders of desk were looked at, its scores were not.
    """

    scenes: tuple[str, ...] = (*DRAWS, *LAYOUTS, DESK)
    """Draws of the kitchen, layouts of benchmarks.scenes with a seed, and desk."""
    choices: tuple[str, ...] = tuple(CHOICES)
    """Ways to choose cameras."""
    seed: int = 2
    """Of the codebook."""
    size: SceneSize = field(default_factory=lambda: SceneSize(n_gaussians=60_000))
    data: Path = field(default_factory=data_folder)
    """Folder that contains kitchen/ and clip/, and desk/."""
    observed: Path | None = None
    """Folder of renders of desk and the regions that models found in them: the first run writes CHOICE/images, a
    later one reads CHOICE/language_features. Without it, rows of renders of desk are left out."""

    rows_depend_on: ClassVar[tuple[str, ...]] = ("seed", "size")

    def check(self) -> None:
        for name in self.choices:
            looked_up("choice", name, CHOICES)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in self.scenes:
            missing = [each for each in self.choices if "scores" not in known.get(f"{name}/{each}", {})]
            scene = make_view_scene(name, self.data, self.size, self.observed) if missing else None
            for choice in missing:
                assert scene is not None
                if choice != "photographs" or name == DESK:
                    yield f"{name}/{choice}", self._figures(scene, choice)

    def _figures(self, scene: ViewScene, choice: str) -> Record:
        cameras = CHOICES[choice](scene)
        try:
            seen = scene.seen_from("given" if choice == "given-half" else choice, cameras)
        except NotObserved as reason:
            return {"left out": str(reason)}
        fitted = WAYS["default"].uplift(seen.inputs(), MethodSettings(self.seed))
        return {
            "views": len(cameras),
            "pairs": seen.pairs,
            "scores": {rule: [round(each, 3) for each in of] for rule, of in score(seen, fitted).items()},
        }

    def line(self, figures: Any) -> str:
        if "left out" in figures:
            return f"left out: {figures['left out']}"
        means = "  ".join(f"{rule} {mean(figures['scores'][rule]):.3f}" for rule in SCORES)
        return f"{figures['views']} views  {means}"

    def record(self, rows: dict[str, Any]) -> Record:
        """Return means over the scenes of a group, and paired differences; each scene counts alike."""
        found = {key: row for key, row in rows.items() if "scores" in row}
        means: Record = {}
        differences: Record = {}
        for group, names in groups_of(self.scenes).items():
            whole = {choice: _rows(found, names, choice) for choice in self.choices}
            means[group] = {choice: _means(of) for choice, of in whole.items() if of}
            differences[group] = {
                f"{one} - {other}": _differences(whole[one], whole[other])
                for one, other in COMPARED
                if whole.get(one) and whole.get(other)
            }
        left_out = {key: row["left out"] for key, row in rows.items() if "left out" in row}
        kept = {key: {name: row[name] for name in row if name != "pairs"} for key, row in found.items()}
        return {"means": means, "differences": differences, "left out": left_out, "rows": kept}

    @staticmethod
    def table(record: Record) -> str:
        """Return one row per group and choice, then the differences."""
        body = [
            [group, choice, f"{of['views']:g}", *(f"{of[rule]:.3f}" for rule in SCORES)]
            for group, choices in record["means"].items()
            for choice, of in choices.items()
        ]
        headers = ["scenes", "cameras", "views", "mIoU", "localisation"]
        differences = [
            [group, pair, *(difference_cell(of[rule]) for rule in SCORES)]
            for group, pairs in record["differences"].items()
            for pair, of in pairs.items()
        ]
        left_out = "".join(f"\nLeft out: {key} ({why})." for key, why in record["left out"].items())
        return (
            markdown(headers, body, left=2)
            + "\n\n"
            + markdown(["scenes", "difference", "mIoU", "localisation"], differences, left=2)
            + left_out
        )


def _rows(found: Record, names: Sequence[str], choice: str) -> dict[str, Record]:
    """Return the rows of a choice by scene; none if a scene lacks it."""
    keys = {name: f"{name}/{choice}" for name in names}
    return {name: found[key] for name, key in keys.items()} if found.keys() >= set(keys.values()) else {}


def _means(rows: Mapping[str, Record]) -> Record:
    scores = {rule: mean(mean(row["scores"][rule]) for row in rows.values()) for rule in SCORES}
    return {"views": mean(row["views"] for row in rows.values())} | scores


def _differences(ones: Mapping[str, Record], others: Mapping[str, Record]) -> Record:
    """Return per rule the mean difference of two choices with its interval."""
    differences: Record = {}
    for rule in SCORES:
        values, labels, scenes = [], [], []
        for name, one in ones.items():
            both = (one["scores"][rule], others[name]["scores"][rule])
            values += [first - second for first, second in zip(*both, strict=True)]
            labels += [label for _, label in one["pairs"]]
            scenes += [name] * len(one["pairs"])
        found = bootstrap_interval(values, labels, scenes=scenes)
        differences[rule] = [round(value, 4) for value in (found.mean, found.low, found.high)]
    return differences


def _chosen(scene: ViewScene, count: int | None, beside: Cameras | None = None) -> Cameras:
    size = scene.given[0]
    return choose_cameras(scene.gaussians, width=size.width, height=size.height, count=count, beside=beside)


def _places(cameras: Cameras) -> Floats:
    return np.stack([camera.position.numpy() for camera in cameras])


def _up(cameras: Cameras) -> Floats:
    """Return the unit mean of what is up in given views."""
    mean_up = -np.mean([camera.viewmat[1, :3].numpy() for camera in cameras], axis=0)
    return mean_up / np.linalg.norm(mean_up)


def _looking(scene: ViewScene, poses: Sequence[tuple[Floats, Floats]], focal: float, up: Floats) -> Cameras:
    size = scene.given[0]
    return Cameras(
        Camera.look_at(eye, aim, f"view_{number:03d}.png", size.width, size.height, focal, up)
        for number, (eye, aim) in enumerate(poses)
    )
