"""Sentences that refer to the things of a synthetic scene, with their masks, in the layout of Ref-LERF.

Every object of a frame has the sentences "the NAME" and "the NAME next to the OTHER", where OTHER is the object nearest
to it; and, if it is clearly on one side of that in the frame, "the NAME left of the OTHER" or "right of". The vector of
a sentence is the mean of those of the names in it, the thing itself counting twice: only who reads it as a phrase
understands it.
"""

from __future__ import annotations

import json
from collections.abc import Collection
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.io import save_png, write_text
from scoup_lab.synthetic.scene import DemoScene, with_texts
from scoup_lab.synthetic.words import unit


def write_referring_truth(scene: DemoScene, tested: Collection[str], folder: Path) -> DemoScene:
    """Write ``json/test_json`` and ``json/train_json`` with the sentences of each view, and ``gt_mask`` with its masks.

    ``tested``: names of the views of ``test_json``. Returns the scene with vectors of all sentences.
    """
    beside = nearest_objects(scene)
    vectors: dict[str, np.ndarray] = {}
    for camera in scene.building:
        frame = scene.labelled_frame(camera.name, ("m",))
        objects = []
        for name, mask in frame.masks.items():
            other = beside[name]
            related = [f"the {name} next to the {other}"]
            if (side := side_of(mask, frame.masks.get(other))) is not None:
                related.append(f"the {name} {side} of the {other}")
            sentences = [f"the {name}", *related]
            own = scene.words.vector(name)
            vectors |= {
                sentences[0]: own,
                **dict.fromkeys(related, unit(2 * own + scene.words.vector(other))),
            }
            picture = f"{frame.name}/{name}.png"
            save_png(mask, folder / "gt_mask" / picture)
            objects.append({"category": name, "segmentation": picture, "sentence": sentences})
        split = "test_json" if camera.name in tested else "train_json"
        write_text(folder / "json" / split / f"{frame.name}.json", json.dumps({"object": objects}) + "\n")
    return with_texts(scene, vectors)


def side_of(mask: Tensor, other: Tensor | None) -> str | None:
    """Return on which side of another mask [H, W] all of a mask is: "left", "right", or None."""
    if other is None:
        return None
    (low, high), (least, most) = ((columns[0], columns[-1]) for columns in (_columns(mask), _columns(other)))
    return "left" if high < least else "right" if low > most else None


def _columns(mask: Tensor) -> list[int]:
    return mask.any(0).nonzero()[:, 0].tolist()


def nearest_objects(scene: DemoScene) -> dict[str, str]:
    """Return for each object of a scene the other one whose middle (the median of its Gaussians) is nearest."""
    of_gaussian = torch.from_numpy(scene.parts.at_level(scene.part_of_gaussian.numpy(), "m"))
    names = [name for number, name in enumerate(scene.parts.objects) if bool((of_gaussian == number).any())]
    middles = torch.stack(
        [
            scene.gaussians.means[of_gaussian == scene.parts.objects.index(name)].double().median(0).values
            for name in names
        ]
    )
    distances = torch.cdist(middles, middles).fill_diagonal_(torch.inf)
    return {name: names[int(row.argmin())] for name, row in zip(names, distances, strict=True)}
