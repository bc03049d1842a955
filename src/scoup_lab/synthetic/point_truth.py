"""The truth of synthetic scenes in the layouts of the point-level data sets: which class every Gaussian is of.

Things of a scene that a benchmark has a class for are of that class; all others are of none (of "otherprop" among
NYU's 40). The text of a class has the vector of the first thing of it in the scene. The text of a class that the scene
lacks has a vector of its own, simulated as those of all words (``scoup_lab.synthetic.words``) about the mean of the
scene's words.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.io.splats.ply import as_stored
from scoup.io.splats.scenesplat import write_scenesplat
from scoup_lab.data.class_names import NYU40, SCANNET20, SCANNET200
from scoup_lab.data.labelled_points import LabelledPoints, write_labelled_ply
from scoup_lab.synthetic.scene import DemoScene, with_texts
from scoup_lab.synthetic.words import TEXT_MEAN, unit

NYU40_OF = {
    "wall": "wall", "floor": "floor", "chair": "chair", "table": "table", "picture": "picture",
    "window": "window", "shelf": "bookshelf", "shelves": "bookshelf", "cushion": "pillow",
    "green cushion": "pillow", "rug": "floormat", "desk lamp": "lamp",
}  # fmt: skip
"""Thing -> one of NYU's 40 classes; books are added by their names."""
SCANNET200_OF = NYU40_OF | {
    "cushion": "cushion", "green cushion": "cushion", "rug": "mat", "bottle": "bottle", "candle": "candle",
    "laptop": "laptop", "alarm clock": "alarm clock", "potted plant": "potted plant", "bowl": "bowl",
    "plate": "plate", "mug": "cup", "ball": "ball", "teddy bear": "stuffed animal",
    "white bear": "stuffed animal", "kettle": "coffee kettle", "basket": "basket", "blue box": "storage bin",
    "red box": "storage bin", "cream box": "box",
}  # fmt: skip
"""The same of ScanNet200's classes, and of ScanNet's 20, which are among them under these names."""
SEGMENTS = {"segment20": SCANNET20, "segment200": SCANNET200}
"""The truths of SceneSplat-Bench: stem of the file -> classes."""
PROMPT = "this is a {}"  # of SceneSplat-Bench
SCAN_NOISE = 0.002  # metres between a point of the scan and the Gaussian that it is drawn from

_NONE = -1


def write_scannet_truth(scene: DemoScene, folder: Path) -> None:
    """Write the labelled points of a scene, one at each Gaussian, under ScanNet's name."""
    classes = classes_of_gaussians(scene, NYU40, NYU40_OF)
    real = scene.part_of_gaussian >= 0
    labels = torch.where(real & (classes == _NONE), NYU40.index("otherprop"), classes.clamp(min=0))
    # At the places in the splat's file, where positions are frozen.
    points = LabelledPoints(as_stored(scene.gaussians).means, labels)
    write_labelled_ply(points, folder / f"{folder.name}_vh_clean_2.labels.ply")


def write_scenesplat_scene(scene: DemoScene, folder: Path) -> None:
    """Write the Gaussians of a scene as arrays with their classes, and points of a scan with theirs."""
    write_scenesplat(scene.gaussians, folder)
    scanned = scene.part_of_gaussian >= 0
    noise = np.random.default_rng(len(scene.gaussians)).normal(0, SCAN_NOISE, (int(scanned.sum()), 3))
    np.save(folder / "pc_coord.npy", (scene.gaussians.means[scanned].numpy() + noise).astype(np.float32))
    for segment, classes in SEGMENTS.items():
        numbers = classes_of_gaussians(scene, classes, SCANNET200_OF).numpy().astype(np.int16)
        np.save(folder / f"{segment}.npy", numbers)
        np.save(folder / f"pc_{segment}.npy", numbers[scanned.numpy()])


POINT_TRUTHS: dict[str, Callable[[DemoScene, Path], None]] = {
    "scannet": write_scannet_truth,
    "scenesplat": write_scenesplat_scene,
}
"""What writes the truth (and, where the layout is its own, the splat) of a scene, by data set."""


def classes_of_gaussians(scene: DemoScene, classes: Sequence[str], things: Mapping[str, str]) -> Tensor:
    """Return [N] int64 position of each Gaussian's class, -1 for those of none."""
    of_object = [
        classes.index(name) if name in classes else _NONE for name in _classes(scene, classes, things)
    ]
    objects = scene.parts.at_level(scene.part_of_gaussian.numpy(), "m")
    return torch.from_numpy(np.array([*of_object, _NONE])[objects])


def with_class_words(scene: DemoScene, data_set: str) -> DemoScene:
    """Return the scene with a vector for the text of every class of a data set ("scannet" or "scenesplat")."""
    if data_set == "scannet":
        return with_texts(scene, _vectors(scene, NYU40, NYU40_OF, "{}"))
    every = tuple(dict.fromkeys(name for classes in SEGMENTS.values() for name in classes))
    return with_texts(scene, _vectors(scene, every, SCANNET200_OF, PROMPT))


def _classes(scene: DemoScene, classes: Sequence[str], things: Mapping[str, str]) -> list[str]:
    """Return the class of each object of a scene; "" for those of none."""
    book = next((name for name in ("books", "book") if name in classes), "")
    return [things.get(name, book if name.endswith(" book") else "") for name in scene.parts.objects]


def _vectors(
    scene: DemoScene, classes: Sequence[str], things: Mapping[str, str], prompt: str
) -> dict[str, np.ndarray]:
    """Return text -> [D] for every class."""
    mean = unit(scene.words.vectors.mean(0))
    random = np.random.default_rng(len(classes)).normal(size=(len(classes), len(mean)))
    concepts = unit(random - (random @ mean)[:, None] * mean)
    absent = unit(TEXT_MEAN * mean + np.sqrt(1 - TEXT_MEAN**2) * concepts)
    found = {prompt.format(name): vector for name, vector in zip(classes, absent, strict=True)}
    shown = list(zip(_classes(scene, classes, things), scene.parts.objects, strict=True))
    for name, thing in reversed(shown):  # the first thing of a class has the last word
        if name in classes:
            found[prompt.format(name)] = scene.words.vector(thing)
    return found
