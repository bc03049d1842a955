"""The demo scene: a splat, cameras, regions, words and the truth about them, made from a seed alone.

Geometry, colours and cameras are made first. What each pixel truly shows follows from the geometry, by a z-buffer over
the meshes. Regions and embeddings are simulated from that truth (``observe``, ``words``). Neither the rasteriser nor
the method takes part in any of it.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError, UnknownNameError
from scoup.scene import LEVELS, Cameras, Gaussians, Regions
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.table import TABLE
from scoup_lab.synthetic.art.things import Parts, Surface
from scoup_lab.synthetic.art.zbuffer import visible_faces
from scoup_lab.synthetic.masks import piece_boxes
from scoup_lab.synthetic.observe import IntMap, observe
from scoup_lab.synthetic.splat import make_splat
from scoup_lab.synthetic.words import CANONICAL, Words, make_words

LABELLED_LEVELS = ("m", "l")  # names of objects and groups are the labels of synthetic frames
SMALLEST_LABEL = 75  # pixels, in an image 480 wide: a thing is labelled where it shows at least that many
EMBEDDING_MODEL = "scoup-demo (simulated)"


@dataclass(frozen=True, eq=False)
class DemoScene:
    """A scene with everything ``scoup`` needs, and the truth."""

    gaussians: Gaussians  # N Gaussians, SH degree 0, in no particular order
    building: Cameras  # cameras of the views with regions
    held_out: Cameras  # cameras of the views without, for scoring
    regions: Regions  # levels s, m, l of the building views, 512-d embeddings
    parts: Parts  # names of parts (s), objects (m) and groups (l), and how they nest
    # the true part of each pixel of every view, [H, W] int32 by view name; -1 = nothing
    part_maps: Mapping[str, IntMap]
    part_of_gaussian: Tensor  # [N] int64, the part each Gaussian lies on; -1 for haze
    words: Words  # text vectors, and the prototypes behind the region embeddings
    layout: Layout = TABLE  # the kind of scene

    @property
    def cameras(self) -> Cameras:
        """Building views first, then the held-out ones."""
        return Cameras([*self.building, *self.held_out])

    @property
    def canonical(self) -> Tensor:
        """[4, D] float32 vectors of the canonical phrases."""
        return self.text_vectors(CANONICAL)

    def text_vectors(self, texts: tuple[str, ...] | list[str]) -> Tensor:
        """Return [Q, D] float32 unit vectors."""
        for text in texts:
            if text not in self.words.texts:
                raise UnknownNameError("word", text, self.words.texts, "the word table of the demo")
        return torch.from_numpy(np.stack([self.words.vector(text) for text in texts])).float()

    def level_of(self, name: str) -> str:
        """Return the level of a name: "m" for objects, else "l" for groups, else "s" for parts."""
        for level in ("m", "l", "s"):
            if name in self.parts.names(level):
                return level
        known = [known for level in LEVELS for known in self.parts.names(level)]
        raise UnknownNameError("thing", name, known, "the demo scene")

    def mask(self, view_name: str, name: str) -> Tensor:
        """Return [H, W] bool: the pixels of a view that truly show a part, object or group."""
        level = self.level_of(name)
        number = self.parts.names(level).index(name)
        return torch.from_numpy(self.parts.at_level(self.part_maps[view_name], level) == number)

    def labelled_frame(self, view_name: str, levels: tuple[str, ...] = ("m",)) -> LabelledFrame:
        """Return the truth of a view in the form that ``scoup_lab.evaluate`` scores.

        A name is labelled where at least ``SMALLEST_LABEL`` pixels (scaled with the image) show it, with one box around
        all of them. A name of several things has a box around each connected piece of that size.
        """
        names = dict.fromkeys(name for level in levels for name in self.parts.names(level))
        masks = {name: self.mask(view_name, name) for name in names}
        return frame_of_masks(view_name, masks, self.parts.several)


def frame_of_masks(
    view_name: str, masks: Mapping[str, Tensor], several: Container[str] = ()
) -> LabelledFrame:
    """Return the masks [H, W] of a view as labels, with their boxes (``DemoScene.labelled_frame``)."""
    height, width = next(iter(masks.values())).shape
    least = SMALLEST_LABEL * (width / 480) ** 2
    shown = {name: mask for name, mask in masks.items() if int(mask.sum()) >= least}
    boxes: dict[str, Tensor] = {}
    for name, mask in shown.items():
        corners = piece_boxes(mask.numpy(), least) if name in several else []
        # Corners of a label's box are pixels inside it.
        rows, columns = (torch.stack(axis.aminmax()).tolist() for axis in mask.nonzero(as_tuple=True))
        corners = corners or [(columns[0], rows[0], columns[1], rows[1])]
        boxes[name] = torch.tensor(corners, dtype=torch.float32)
    return LabelledFrame(view_name.rsplit(".", 1)[0], width, height, shown, boxes)


def make_demo_scene(
    seed: int = 0,
    n_gaussians: int = 160_000,
    width: int = 480,
    height: int = 360,
    n_building: int = 24,
    n_held_out: int = 6,
    layout: Layout = TABLE,
) -> DemoScene:
    """Make a scene of exactly N Gaussians, ``n_building`` views with regions and ``n_held_out`` without, for scoring.
    The same arguments give the same scene, to the last bit on one machine."""
    if n_gaussians < 2000 or min(width, height) < 32 or n_building < 1 or n_held_out < 0:
        raise InputError(
            "a demo scene needs at least 2000 Gaussians, 32 x 32 pixels and one view, "
            f"not {n_gaussians} Gaussians, {width} x {height} pixels and {n_building} views"
        )
    # A generator for each purpose: a change to what one draws does not change the others.
    for_cameras, for_splat, for_words, for_regions = (
        np.random.default_rng([seed, purpose]) for purpose in range(4)
    )
    things = layout.things()
    parts = Parts.of(things)
    surface = Surface.of(things, parts)
    building, held_out = layout.cameras(n_building, n_held_out, width, height, for_cameras)

    part_of_face = np.append(surface.part_of_face, -1).astype(np.int32)
    seen = np.zeros(len(part_of_face), bool)
    part_maps: dict[str, IntMap] = {}
    for camera in (*building, *held_out):
        faces = visible_faces(surface.mesh.vertices, surface.mesh.faces, camera)
        part_maps[camera.name] = part_of_face[faces]
        if camera.name in building.names:
            seen[faces] = True
    splat = make_splat(things, parts, n_gaussians, for_splat, layout.light, seen[:-1])
    words = make_words(parts, for_words)
    regions = observe({name: part_maps[name] for name in building.names}, parts, words, for_regions)
    return DemoScene(
        splat.gaussians,
        building,
        held_out,
        regions,
        parts,
        part_maps,
        torch.from_numpy(splat.part_of_gaussian),
        words,
        layout,
    )


def with_texts(scene: DemoScene, vectors: Mapping[str, np.ndarray]) -> DemoScene:
    """Return the scene with more words; existing words keep their vectors."""
    words = scene.words
    new = {text: vector for text, vector in vectors.items() if text not in words.texts}
    texts, rows = (*words.texts, *new), np.concatenate([words.vectors, np.stack(list(new.values()))])
    return replace(scene, words=replace(words, texts=texts, vectors=rows))
