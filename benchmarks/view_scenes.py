"""Scenes that are observed from any cameras: regions of their views, simulated, or by real models from renders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch

import scoup
from benchmarks.answer_scenes import AnswerScene, DrawName, SceneSize, Texts, prepared, texts_of
from benchmarks.embedding_kinds import KINDS
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.real_scenes import RealScene
from benchmarks.scenes import scene_of
from scoup.base.errors import InputError
from scoup.extract.own_views import save_views
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.synthetic.art.things import Surface
from scoup_lab.synthetic.art.zbuffer import visible_faces
from scoup_lab.synthetic.observe import observe
from scoup_lab.synthetic.scene import LABELLED_LEVELS, DemoScene
from scoup_lab.synthetic.words import CANONICAL, DISTRACTORS

REGIONS = "language_features"
DESK = "desk"
SAME = 1e-4  # largest difference of the poses of the same cameras


class NotObserved(Exception):
    """Why a scene has no regions from some cameras."""


@dataclass(frozen=True, eq=False)
class ViewScene:
    """A scene, its given cameras, and its labelled views, which no field is built from."""

    name: str
    gaussians: Gaussians
    given: Cameras  # those without labels
    asked: list[tuple[LabelledFrame, Camera]]
    texts: Texts
    observe: Callable[[str, Cameras], Regions]  # by the name of the way in which the cameras are chosen

    def seen_from(self, choice: str, cameras: Cameras) -> AnswerScene:
        """Return the scene with regions of these cameras.

        Raises:
            NotObserved: there are no regions of them.
        """
        regions = self.observe(choice, cameras)
        return prepared(self.name, self.gaussians, cameras, regions, self.asked, self.texts, {})


def make_view_scene(name: str, data: Path, size: SceneSize, observed: Path | None) -> ViewScene:
    """Return a scene by name: a draw of the kitchen, "desk", or a layout and a seed, such as "table-1".

    ``observed``: folder of the renders of desk and of what models found in them (``observe_desk``).
    """
    if name == DESK:
        return _desk(data, observed)
    draw = DrawName.parse(name)
    if draw is not None:
        return _kitchen(data, draw, size.kitchen_scale)
    return _procedural(name, size)


def _procedural(name: str, size: SceneSize) -> ViewScene:
    demo = scene_of(name, *size.of_procedural())
    labelled = [(demo.labelled_frame(camera.name, LABELLED_LEVELS), camera) for camera in demo.held_out]
    words = tuple(word for word in demo.words.texts if word not in CANONICAL)
    return ViewScene(
        name,
        demo.gaussians,
        demo.building,
        [(frame, camera) for frame, camera in labelled if frame.labels],
        Texts(demo.canonical, words, demo.text_vectors(words), DISTRACTORS),
        lambda _, cameras: observe_procedural(demo, int(name.rpartition("-")[2]), cameras),
    )


def observe_procedural(demo: DemoScene, seed: int, cameras: Cameras) -> Regions:
    """Return regions of a procedural scene from any cameras; from its own ones exactly its own."""
    surface = Surface.of(demo.layout.things(), demo.parts)
    part_of_face = np.append(surface.part_of_face, -1).astype(np.int32)
    maps = {
        camera.name: part_of_face[visible_faces(surface.mesh.vertices, surface.mesh.faces, camera)]
        for camera in cameras
    }
    return observe(maps, demo.parts, demo.words, np.random.default_rng([seed, 3]))


def _kitchen(data: Path, name: DrawName, scale: float) -> ViewScene:
    truth = Truth.open(data, scale)
    kind = KINDS[name.kind] if name.kind else None
    frames = make_draw(truth, name.seed, name.noise, kind).frames
    labelled = {camera.name for _, camera in frames}
    return ViewScene(
        str(name),
        truth.gaussians,
        truth.cameras.select(lambda camera: camera.name not in labelled),
        frames,
        texts_of(data, truth),
        lambda _, cameras: make_draw(replace(truth, cameras=cameras), name.seed, name.noise, kind).regions,
    )


def _desk(data: Path, observed: Path | None) -> ViewScene:
    desk = RealScene.open(DESK, data)
    gaussians = scoup.load_gaussians(data / DESK / "point_cloud.splat")
    labelled = {camera.name for _, camera in desk.frames}

    def regions(choice: str, cameras: Cameras) -> Regions:
        if choice == "photographs":
            return desk.regions
        return observe_desk(gaussians, cameras, choice, observed)

    return ViewScene(
        DESK,
        gaussians,
        desk.cameras.select(lambda camera: camera.name not in labelled),
        desk.frames,
        Texts(desk.canonical, desk.words, desk.everyday, desk.absent),
        regions,
    )


def observe_desk(gaussians: Gaussians, cameras: Cameras, choice: str, observed: Path | None) -> Regions:
    """Return regions that models, run outside of this repository, found in renders from these cameras.

    Where there are none yet, the renders are written to ``observed``/``choice``.

    Raises:
        NotObserved: there are none yet, or no folder was named.
        InputError: they are of other cameras.
    """
    if observed is None:
        raise NotObserved("--observed is not given")
    folder = observed / choice
    poses = folder / "transforms.json"
    if not poses.exists():
        renders = Cameras(replace(each, name=_png(each.name), image_path=None) for each in cameras)
        save_views(gaussians, renders, folder, overwrite=True)
    kept = scoup.load_cameras(folder)
    for camera in cameras:
        if not torch.allclose(kept[_png(camera.name)].viewmat, camera.viewmat, atol=SAME):
            raise InputError(f"{folder}: its cameras are not those chosen today; remove it and extract again")
    if not (folder / REGIONS).is_dir():
        raise NotObserved(f"{folder / REGIONS} does not exist")
    return scoup.load_regions(folder / REGIONS, cameras)


def _png(name: str) -> str:
    return f"{name.rsplit('.', 1)[0]}.png"
