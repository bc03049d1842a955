"""Synthetic data sets, complete, in the layouts of LERF-OVS, 3D-OVS, Mip-NeRF 360 and ScanNet.

Every scene is made by ``scoup_lab.synthetic.make_demo_scene``. Nothing was photographed, trained or labelled by hand,
and scores say nothing about the data set whose layout is used. Scenes are named after their layouts, so that nobody
mistakes them for scenes of that data set. As in the real ones, labelled views are among those a field is built from.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from scoup.base import InputError, OutputExistsError, Progress, looked_up, no_progress, staged, write_text
from scoup.io import save_png
from scoup.scene import Camera, Cameras, Regions
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.table import TABLE
from scoup_lab.synthetic.folder import label_file, picture_of, write_scene
from scoup_lab.synthetic.point_truth import with_class_words, write_scannet_truth
from scoup_lab.synthetic.scene import LABELLED_LEVELS, DemoScene, make_demo_scene

NOTE = """A data set made by a program, in the layout of {name}. Nothing in it was photographed,
trained or labelled by hand: scores on it say nothing about {name}.

SCENE/point_cloud.ply     the Gaussians
SCENE/images/             renders of them, in place of photographs
SCENE/sparse/0/           their cameras, as COLMAP writes them
SCENE/language_features/  simulated regions and embeddings
SCENE/text.npz            simulated text vectors of the scene: names [M], vectors [M, 512]
{labels}

Score it:
    scoup eval {name} .
"""
IMAGE_NAMES = {
    "lerf-ovs": "frame_{:05d}.png",
    "3d-ovs": "{:02d}.png",
    "mipnerf360": "DSCF{:04d}.png",
    "scannet": "{}.png",
}
"""Names of the images of a data set, counted from 1 (from 0 in 3D-OVS)."""
LABELS = "label/SCENE/             the truth: one JSON and its picture a labelled frame"
TRUTHS = {
    "3d-ovs": "SCENE/segmentations/      the truth: classes.txt, and <frame>/<class>.png with 0 or 255",
    "scannet": "SCENE/*.labels.ply        the truth: a point at each Gaussian, with its class among NYU's 40",
}


@dataclass(frozen=True)
class DataSetSize:
    """Sizes of a synthetic data set."""

    n_gaussians: int = 60_000  # of each scene
    width: int = 320  # of its views, in pixels
    height: int = 240
    n_views: int = 16  # views with regions
    n_labelled: int = 4  # how many of them have labels, spread evenly
    label_scale: float = 1.0  # size of the labels relative to the views, for Mip-NeRF 360


def write_data_set(
    data_set: str,
    root: str | Path,
    layouts: Sequence[Layout] = (TABLE,),
    size: DataSetSize = DataSetSize(),
    seeds: Sequence[int] = (0,),
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> tuple[str, ...]:
    """Write a complete data set, so that ``scoup eval NAME ROOT`` runs on it.

    ``data_set``: one of ``IMAGE_NAMES``; ``seeds``: of everything random. There is a scene for each layout
    and seed, named after the layout, and with several seeds after layout and seed ("table_0"); ``progress``:
    called as ``progress("synthetic data set", done, total)`` after each scene. Returns the names of the
    scenes.
    """
    pattern, root = looked_up("data set", data_set, IMAGE_NAMES), Path(root)
    if not 1 <= size.n_labelled <= size.n_views or not 0 < size.label_scale <= 4:
        raise InputError(
            f"a synthetic scene needs 1 to {size.n_views} labelled views and labels of 0 to 4 times their size, not "
            f"{size.n_labelled} and {size.label_scale}"
        )
    scenes = [(layout, seed) for layout in layouts for seed in seeds]
    names = tuple(f"{layout.name}_{seed}" if len(seeds) > 1 else layout.name for layout, seed in scenes)
    if not names or len(set(names)) < len(names):
        raise InputError(
            f"a data set needs at least one scene, and scenes of different names, got {list(names)}"
        )
    for name in names:
        if (root / name).exists() and not overwrite:
            raise OutputExistsError(root / name)
    labels = TRUTHS.get(data_set, LABELS)
    with staged(root, ["README.txt"], overwrite) as hidden:
        for number, (name, (layout, seed)) in enumerate(zip(names, scenes, strict=True)):
            progress("synthetic data set", number, len(names))
            scene = make_demo_scene(seed, size.n_gaussians, size.width, size.height, size.n_views, 0, layout)
            _write_scene(data_set, _renamed(scene, pattern), hidden, name, size)
        progress("synthetic data set", len(names), len(names))
        write_text(hidden / "README.txt", NOTE.format(name=data_set, labels=labels))
    return names


def _renamed(scene: DemoScene, pattern: str) -> DemoScene:
    """Return the scene with its building views renamed as in the data set. The second name is left out, as if
    that image had failed to register, so that nothing can mistake numbers in names for indices."""
    first = 0 if pattern.startswith("{:02d}") else 1
    numbers = [number for number in range(first, first + len(scene.building) + 1) if number != first + 1]
    names = {
        pattern.format(number): camera.name for number, camera in zip(numbers, scene.building, strict=True)
    }
    cameras = [replace(scene.building[old], name=new) for new, old in names.items()]
    regions = scene.regions
    return replace(
        scene,
        building=Cameras(cameras),
        regions=Regions(regions.levels, names, lambda name, level: regions.load(names[name], level)),
        part_maps={new: scene.part_maps[old] for new, old in names.items()},
    )


def _write_scene(data_set: str, scene: DemoScene, root: Path, name: str, size: DataSetSize) -> None:
    folder = root / name
    labelled = {scene.building[i].name for i in np.linspace(0, size.n_views - 1, size.n_labelled).astype(int)}
    if data_set == "scannet":
        scene = with_class_words(scene)
        write_scannet_truth(scene, folder)
    write_scene(scene, folder)
    for camera in scene.building:
        image = picture_of(scene, camera)
        save_png(image, folder / "images" / camera.name)
        if camera.name in labelled and data_set not in TRUTHS:
            _write_label(data_set, scene, camera, image, root / "label" / name, size)
    if data_set == "3d-ovs":
        _write_segmentations(scene, sorted(labelled), folder / "segmentations")


def _write_label(
    data_set: str, scene: DemoScene, camera: Camera, image: np.ndarray, folder: Path, size: DataSetSize
) -> None:
    frame = scene.labelled_frame(camera.name, LABELLED_LEVELS)
    if data_set == "mipnerf360" and size.label_scale != 1:
        frame = frame.resized(round(frame.width * size.label_scale), round(frame.height * size.label_scale))
    content = label_file(frame, camera.name, {label: scene.level_of(label) for label in frame.labels})
    write_text(folder / f"{frame.name}.json", json.dumps(content) + "\n")
    save_png(image, folder / camera.name)


def _write_segmentations(scene: DemoScene, views: list[str], folder: Path) -> None:
    """Write the masks of the labelled views. As in the real data set, a class is visible in all of them."""
    frames = [scene.labelled_frame(name, LABELLED_LEVELS) for name in views]
    classes = [label for label in frames[0].labels if all(label in frame.masks for frame in frames)]
    if not classes:
        raise InputError(
            f"{folder.parent.name}: the labelled views have no object in common; make more or larger views"
        )
    for frame in frames:
        for label in classes:
            save_png(frame.masks[label], folder / frame.name / f"{label}.png")
    write_text(folder / "classes.txt", "".join(f"{label}\n" for label in classes))
