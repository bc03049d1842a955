"""Panoptic maps with the faults of a real segmenter, by seed, and the truth they are made from.

A panoptic segmenter gives one map a view, so there is one level. Each segment has a class out of few, and a region's
embedding is the vector of the class that the segmenter predicted: all regions of a class have the same one.

Classes are the objects of procedural scenes (20 to 70), or of the kitchen (38, and one more for what has no label,
which is not scored). "kitchen/8" has eight classes, each of some objects drawn at random. Class vectors follow CLIP:
two of them have a cosine of about .55, related ones (of one group of the scene) of .8 to .9.

The segments of a view are the connected pieces of the true classes. Their faults:

* borders are off by smooth noise; small pieces are missing, and 6 % of the others;
* 4 % are merged with the neighbour they touch most: one segment of the neighbour's class;
* over 10 % the surroundings bleed by 2 to 6 pixels;
* 5 to 15 % (drawn by seed; twice that where they are small) have the class of something else, more often a related one;
* 5 to 20 % of the classes (drawn by seed) are taken for one certain other class from 30 % of the viewpoints, those on
  one side of the scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from torch import Tensor

from benchmarks.kitchen_draws import GROUPS, Truth
from benchmarks.scenes import find_layout
from scoup import raster
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.masks import components, grown, shrunk
from scoup_lab.synthetic.observe import LEAST_KEPT, REFERENCE_WIDTH, SMALL_AREA, IntMap, moved_borders
from scoup_lab.synthetic.scene import make_demo_scene
from scoup_lab.synthetic.words import unit

LEVEL = "m"
DIMENSIONS = 512
N_VIEWS, N_HELD_OUT = 13, 5
KITCHEN_SCALE = 0.5  # of its views of 960 x 720
COMMON = 0.55  # cosine of unrelated classes
RELATED = (0.8, 0.9)  # cosine of related ones
SMALLEST = 45  # pixels, in a view 480 wide; smaller pieces are missed
MISSING, MERGED, BLEEDING = 0.06, 0.04, 0.10
MISCLASSIFIED = (0.05, 0.15)
AS_RELATED = 0.6  # of those misclassified, if there is a related class
CONFUSED = (0.05, 0.2)  # share of the classes
CONFUSED_FROM = 0.3  # share of the views


@dataclass(frozen=True, eq=False)
class PanopticTruth:
    """A scene and what is truly in it.

    Attributes:
        name: for tables.
        gaussians: N of them.
        building, held_out: cameras of the views with maps, and of those that are scored.
        shown: true class of each pixel of every view, [H, W] int32 by view name; -1 = nothing.
        of_gaussian: [N] int64 true class; -1 where it is not known.
        groups: [C] int64; classes of one group are related.
        scored: [C] boolean.
    """

    name: str
    gaussians: Gaussians
    building: Cameras
    held_out: Cameras
    shown: Mapping[str, IntMap]
    of_gaussian: NDArray[np.int64]
    groups: NDArray[np.int64]
    scored: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class PanopticMaps:
    """What a faulty segmenter made of the building views.

    Attributes:
        regions: one level; the embedding of a region is the vector of its predicted class.
        classes: [R] int64 predicted class of each region, in the order of ``Regions.embeddings``.
        vectors: [C, D] float32 unit vectors of the classes.
    """

    regions: Regions
    classes: NDArray[np.int64]
    vectors: Tensor


def panoptic_truth(name: str, data: Path, n_gaussians: int = 60_000) -> PanopticTruth:
    """The truth of "kitchen", or of a layout of ``benchmarks.scenes`` and a seed, such as "hall-1"; with a number of
    classes if they are to be fewer than the objects: "hall-1/8".

    Args:
        name: of the scene.
        data: folder that holds kitchen/ and clip/.
        n_gaussians: of procedural scenes.
    """
    scene, _, count = name.partition("/")
    truth = _kitchen(data) if scene == "kitchen" else _procedural(scene, n_gaussians)
    return replace(_merged(truth, int(count)) if count else truth, name=name)


def _procedural(name: str, n_gaussians: int) -> PanopticTruth:
    layout, _, seed = name.rpartition("-")
    scene = make_demo_scene(
        int(seed), n_gaussians, n_building=N_VIEWS, n_held_out=N_HELD_OUT, layout=find_layout(layout)
    )
    shown = {
        view: scene.parts.at_level(part_map, LEVEL).astype(np.int32)
        for view, part_map in scene.part_maps.items()
    }
    groups = scene.parts.group_of_object
    numbers = scene.parts.at_level(scene.part_of_gaussian.numpy(), LEVEL)
    scored = np.ones(len(groups), bool)
    return PanopticTruth(
        name, scene.gaussians, scene.building, scene.held_out, shown, numbers, groups, scored
    )


def _merged(truth: PanopticTruth, count: int) -> PanopticTruth:
    """The scene with ``count`` classes in place of those that are scored, each at least one of these; half of them in
    related pairs."""
    rng = np.random.default_rng(count)
    scored = np.flatnonzero(truth.scored)
    of_scored = rng.permutation(np.append(np.arange(count), rng.integers(0, count, len(scored) - count)))
    new = np.full(len(truth.scored) + 1, -1)  # the last is what -1 becomes
    new[scored] = of_scored
    others = np.flatnonzero(~truth.scored)
    new[others] = count + np.arange(len(others))
    pairs = np.where(np.arange(count) < count // 2, np.arange(count) // 2, np.arange(count))
    return replace(
        truth,
        shown={view: new[classes].astype(np.int32) for view, classes in truth.shown.items()},
        of_gaussian=new[truth.of_gaussian],
        groups=np.append(pairs, new[others]),
        scored=np.arange(count + len(others)) < count,
    )


def _kitchen(data: Path) -> PanopticTruth:
    truth = Truth.open(data, KITCHEN_SCALE)
    numbers = np.array([0, *sorted(truth.names)])  # class 0 is what has no label
    classes = np.searchsorted(numbers, truth.ids)
    groups = np.arange(len(numbers))
    for members in GROUPS.values():
        groups[np.isin(numbers, members)] = groups[numbers == members[0]]
    places = np.linspace(0, len(truth.cameras) - 1, N_HELD_OUT + 2).round().astype(int)[1:-1]
    cameras = list(truth.cameras)
    others = [camera for place, camera in enumerate(cameras) if place not in places]
    chosen = np.linspace(0, len(others) - 1, N_VIEWS).round().astype(int)
    building = Cameras([others[place] for place in chosen])
    held_out = Cameras([cameras[place] for place in places])
    shown = {
        camera.name: _rendered(truth.gaussians, classes, len(numbers), camera)
        for camera in (*building, *held_out)
    }
    scored = numbers > 0
    return PanopticTruth(
        "kitchen",
        truth.gaussians,
        building,
        held_out,
        shown,
        np.where(scored[classes], classes, -1),
        groups,
        scored,
    )


def _rendered(gaussians: Gaussians, classes: NDArray[np.int64], count: int, camera: Camera) -> IntMap:
    """[H, W] the class that is painted most."""
    indices = torch.from_numpy(classes)[:, None, None].to(torch.uint8)
    projection = raster.project(gaussians, camera)
    (image,) = raster.render_codes(projection, indices, torch.ones(indices.shape), count)
    return image.argmax(2).int().numpy()


def make_panoptic_maps(truth: PanopticTruth, seed: int) -> PanopticMaps:
    """The maps of the building views. The same truth and seed give the same maps."""
    for_vectors, for_classes, for_views = (np.random.default_rng([seed, purpose]) for purpose in range(3))
    vectors = class_vectors(truth.groups, for_vectors).astype(np.float32)
    misclassified = for_classes.uniform(*MISCLASSIFIED)
    taken_for = _confusions(truth, for_classes)
    maps: dict[str, dict[str, RegionMap]] = {}
    predicted = []
    for camera in truth.building:
        labels, true = segments(truth.shown[camera.name], for_views)
        small = np.bincount(labels[labels >= 0], minlength=len(true)) < _pixels(SMALL_AREA, labels)
        wrong = for_views.random(len(true)) < misclassified * np.where(small, 2, 1)
        other = np.array([_other(number, truth.groups, for_views) for number in true], np.int64)
        classes = np.where(wrong, other, taken_for[camera.name][true])
        predicted.append(classes)
        maps[camera.name] = {LEVEL: RegionMap(torch.from_numpy(labels), torch.from_numpy(vectors[classes]))}
    return PanopticMaps(Regions.from_maps(maps), np.concatenate(predicted), torch.from_numpy(vectors))


def class_vectors(
    groups: NDArray[np.int64], rng: np.random.Generator, dimensions: int = DIMENSIONS
) -> Floats:
    """[C, D] float64 unit vectors: all share a mean direction, and classes of one group [C] one more."""
    count = len(groups)
    mean, own, shared = (
        unit(rng.normal(size=(rows, dimensions))) for rows in (1, count, int(groups.max()) + 1)
    )
    cosine = rng.uniform(*RELATED, len(shared))[groups][:, None]
    return unit(
        np.sqrt(COMMON) * mean + np.sqrt(cosine - COMMON) * shared[groups] + np.sqrt(1 - cosine) * own
    )


def _confusions(truth: PanopticTruth, rng: np.random.Generator) -> dict[str, NDArray[np.int64]]:
    """View name -> [C] the class that each is taken for there."""
    count = len(truth.groups)
    chosen = rng.permutation(count)[: round(rng.uniform(*CONFUSED) * count)]
    poses = [camera.viewmat.double().numpy() for camera in truth.building]
    centres = np.stack([-pose[:3, :3].T @ pose[:3, 3] for pose in poses])
    taken_for = np.tile(np.arange(count), (len(centres), 1))
    for number in chosen:
        along = centres @ rng.normal(size=3)
        from_there = along >= np.quantile(along, 1 - CONFUSED_FROM)
        taken_for[from_there, number] = _other(int(number), truth.groups, rng)
    return dict(zip(truth.building.names, taken_for, strict=True))


def _other(number: int, groups: NDArray[np.int64], rng: np.random.Generator) -> int:
    """Another class, more often a related one."""
    others = np.delete(np.arange(len(groups)), number)
    related = others[groups[others] == groups[number]]
    if len(related) and rng.random() < AS_RELATED:
        others = related
    return int(rng.choice(others))


def segments(shown: IntMap, rng: np.random.Generator) -> tuple[IntMap, NDArray[np.int64]]:
    """The segments of a view with true classes ``shown`` [H, W]: labels [H, W] int32 from 0, -1 for none; and the true
    class of each."""
    moved = moved_borders(shown, rng)
    labels, true = _pieces(moved)
    fate = rng.random(len(true))
    merged = MISSING + MERGED
    scale = shown.shape[1] / REFERENCE_WIDTH
    for number in rng.permutation(len(true)):
        mask = labels == number
        around = labels[grown(mask, 2) & ~mask]
        around = around[around >= 0]
        if fate[number] < MISSING:
            labels[mask] = -1
        elif fate[number] < merged + BLEEDING and len(around):
            taken = mask
            if fate[number] >= merged:
                taken = mask & ~shrunk(mask, max(1, round(rng.uniform(2, 6) * scale)))
            labels[taken] = np.bincount(around).argmax()
    sizes = np.bincount(labels[labels >= 0], minlength=len(true))
    kept = sizes >= LEAST_KEPT
    numbers = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)
    return numbers[labels].astype(np.int32), true[kept]


def _pieces(shown: IntMap) -> tuple[IntMap, NDArray[np.int64]]:
    """The connected pieces of the classes, unless too small: labels [H, W] from 0, -1 for none, and their classes."""
    labels = np.full(shown.shape, -1, np.int32)
    classes: list[int] = []
    for number, box in enumerate(ndimage.find_objects(shown + 1)):
        if box is None:
            continue
        pieces, count = components(shown[box] == number)
        sizes = np.bincount(pieces.ravel(), minlength=count + 1)
        for piece in range(1, count + 1):
            if sizes[piece] >= _pixels(SMALLEST, shown):
                labels[box][pieces == piece] = len(classes)
                classes.append(number)
    return labels, np.array(classes, np.int64)


def _pixels(area: float, image: IntMap) -> float:
    """An area in a view 480 wide, in pixels of this one."""
    return max(LEAST_KEPT, area * (image.shape[1] / REFERENCE_WIDTH) ** 2)
