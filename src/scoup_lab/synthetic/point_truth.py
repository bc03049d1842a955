"""The truth of synthetic scenes in the layout of ScanNet: which of NYU's 40 classes every Gaussian is of.

Things of a scene that there is a class for are of that class; all others are of "otherprop". The text of a class has
the vector of the first thing of it in the scene. The text of a class that the scene lacks has a vector of its own,
simulated as those of all words (``scoup_lab.synthetic.words``) about the mean of the scene's words.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup_lab.data.labelled_points import NYU40, LabelledPoints, write_labelled_ply
from scoup_lab.synthetic.scene import DemoScene, with_texts
from scoup_lab.synthetic.words import TEXT_MEAN, unit

NYU40_OF = {
    "wall": "wall", "floor": "floor", "chair": "chair", "table": "table", "picture": "picture",
    "window": "window", "shelf": "bookshelf", "shelves": "bookshelf", "cushion": "pillow",
    "green cushion": "pillow", "rug": "floormat", "desk lamp": "lamp",
}  # fmt: skip
"""Thing -> one of NYU's 40 classes; books are added by their names."""
_NONE = -1


def write_scannet_truth(scene: DemoScene, folder: Path) -> None:
    """Write the labelled points of a scene, one at each Gaussian, under ScanNet's name."""
    classes = classes_of_gaussians(scene)
    real = scene.part_of_gaussian >= 0
    labels = torch.where(real & (classes == _NONE), NYU40.index("otherprop"), classes.clamp(min=0))
    points = LabelledPoints(scene.gaussians.means, labels)
    write_labelled_ply(points, folder / f"{folder.name}_vh_clean_2.labels.ply")


def classes_of_gaussians(scene: DemoScene) -> Tensor:
    """Return [N] int64 number of each Gaussian's class among NYU's 40, -1 for those of none."""
    of_object = [NYU40.index(name) if name in NYU40 else _NONE for name in _classes(scene)]
    objects = scene.parts.at_level(scene.part_of_gaussian.numpy(), "m")
    return torch.from_numpy(np.array([*of_object, _NONE])[objects])


def with_class_words(scene: DemoScene) -> DemoScene:
    """Return the scene with a vector for the text of every class of NYU's 40."""
    return with_texts(scene, _vectors(scene))


def _classes(scene: DemoScene) -> list[str]:
    """Return the class of each object of a scene; "" for those of none."""
    return [NYU40_OF.get(name, "books" if name.endswith(" book") else "") for name in scene.parts.objects]


def _vectors(scene: DemoScene) -> dict[str, np.ndarray]:
    """Return text -> [D] for every class."""
    mean = unit(scene.words.vectors.mean(0))
    random = np.random.default_rng(len(NYU40)).normal(size=(len(NYU40), len(mean)))
    concepts = unit(random - (random @ mean)[:, None] * mean)
    absent = unit(TEXT_MEAN * mean + np.sqrt(1 - TEXT_MEAN**2) * concepts)
    vectors = dict(zip(NYU40, absent, strict=True))
    shown = list(zip(_classes(scene), scene.parts.objects, strict=True))
    for name, thing in reversed(shown):  # the first thing of a class has the last word
        if name in vectors:
            vectors[name] = scene.words.vector(thing)
    return vectors
