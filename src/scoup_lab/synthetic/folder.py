"""A demo scene as a folder on disk, in the layouts of real scenes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from scoup.base import Progress, no_progress, staged, write_text
from scoup.io import save_gaussians, save_png, save_regions, write_transforms
from scoup.models import WordTable
from scoup.raster import render_colors
from scoup.scene import LEVELS, SH_C0, Camera
from scoup_lab.data.colmap_model import write_colmap
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.synthetic.masks import mask_polygons
from scoup_lab.synthetic.scene import EMBEDDING_MODEL, LABELLED_LEVELS, DemoScene

SPARSE_POINTS = 4000
FILES = (
    "README.txt",
    "point_cloud.ply",
    "text.npz",
    "words.txt",
    "sparse/0/cameras.bin",
    "held_out/transforms.json",
)
"""Some of those that ``write_demo_scene`` writes: where one is there already, it is refused before any work."""

NOTE = """A {title} made by a program (scoup demo). Nothing in it was photographed or trained.

point_cloud.ply      the Gaussians, in the layout of the 3DGS reference code
images/              renders of them, in place of photographs
sparse/0/            their cameras, as COLMAP writes them
language_features/   simulated regions and embeddings
text.npz             simulated text vectors: names [M], vectors [M, 512]
words.txt            the names of what is in the scene
held_out/            views without regions: images/, transforms.json (nerfstudio's layout), and
                     label/ with the truth as LERF-OVS label files

Build and query:
    scoup build . --model text.npz --out field.scoup
    scoup query field.scoup "{name}"
"""


def write_demo_scene(scene: DemoScene, folder: str | Path, progress: Progress = no_progress) -> Path:
    """Write a scene so that ``scoup build FOLDER`` works on it; ``NOTE`` says what lies where.

    ``progress`` is called for the stage "render".
    """
    folder = Path(folder)
    with staged(folder, [*FILES, *(f"images/{name}" for name in scene.building.names)]) as hidden:
        _write_all(scene, hidden, progress)
    return folder


def _write_all(scene: DemoScene, folder: Path, progress: Progress) -> None:
    """Write everything into a new folder."""
    held_out = folder / "held_out"
    write_scene(scene, folder)
    cameras = scene.cameras
    for done, camera in enumerate(cameras):
        progress("render", done, len(cameras))
        base = folder if camera.name in scene.building.names else held_out
        save_png(picture_of(scene, camera), base / "images" / camera.name)
    progress("render", len(cameras), len(cameras))

    if len(scene.held_out):
        write_transforms(scene.held_out, held_out / "transforms.json")
    for camera in scene.held_out:
        frame = scene.labelled_frame(camera.name, LABELLED_LEVELS)
        content = label_file(frame, camera.name, {name: scene.level_of(name) for name in frame.labels})
        write_text(held_out / "label" / f"{frame.name}.json", json.dumps(content) + "\n")
    note = NOTE.format(title=scene.layout.title, name=scene.layout.favourites[0])
    write_text(folder / "README.txt", note)
    names = dict.fromkeys(name for level in LEVELS for name in scene.parts.names(level))
    write_text(folder / "words.txt", "".join(f"{name}\n" for name in names))


def picture_of(scene: DemoScene, camera: Camera) -> np.ndarray:
    """Return the colour render of a view, [H, W, 3] uint8."""
    return (render_colors(scene.gaussians, camera).numpy() * 255 + 0.5).astype(np.uint8)


def label_file(frame: LabelledFrame, image_name: str, groups: dict[str, str]) -> dict[str, Any]:
    """Return the content of a LERF-OVS label file of one frame; ``groups`` maps to the level of each name."""
    objects = []
    for name, mask in frame.masks.items():
        for number, (corners, box) in enumerate(mask_polygons(mask.numpy())):
            objects.append(
                {
                    "category": name,
                    "group": groups[name],
                    "segmentation": [list(corner) for corner in corners],
                    "area": int(mask.sum()),
                    "layer": float(number + 1),
                    "bbox": list(box),
                    "iscrowd": False,
                    "note": "",
                }
            )
    info = {"name": image_name, "width": frame.width, "height": frame.height, "depth": 3, "note": "simulated"}
    return {"info": info, "objects": objects}


def write_scene(scene: DemoScene, folder: Path) -> None:
    """Write all of a scene's folder but its images: splat, cameras with some points, regions and text vectors."""
    save_gaussians(scene.gaussians, folder / "point_cloud.ply")
    count = len(scene.gaussians)
    points = np.linspace(0, count - 1, min(SPARSE_POINTS, count)).astype(int)
    colors = (scene.gaussians.sh[points, 0].numpy() * SH_C0 + 0.5).clip(0, 1) * 255
    positions = scene.gaussians.means[points].double().numpy()
    write_colmap(scene.building, folder / "sparse" / "0", (positions, colors.astype(np.uint8)))
    save_regions(scene.regions, folder / "language_features")
    WordTable.save(folder / "text.npz", scene.words.texts, scene.words.vectors, model=EMBEDDING_MODEL)
