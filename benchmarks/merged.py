"""Pages with fewer Gaussians than their scene: how near pictures and answers are to those of all Gaussians."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from statistics import mean

import torch
from torch import Tensor

import scoup
from benchmarks.kitchen_draws import Truth, make_draw
from benchmarks.real_scenes import RealScene
from benchmarks.scenes import scene_of
from benchmarks.study import Record
from scoup import raster
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.view.decimation import PageGaussians, cover, decimate
from scoup_lab.synthetic.scene import LABELLED_LEVELS

TUNED = ("kitchen-21", "desk")
"""The rule of merging was chosen by pictures of these two splats."""
OTHERS = ("guitar", "table-4", "shelves-2", "hall-3", "yard-3")
PARTS = (4, 10, 50)  # all Gaussians by those that are left
VIEWS = 4
SEEN = 0.5  # blending weight from which a pixel shows a selection


def of_scene(name: str, data: Path) -> Record:
    """Return decibels of the pictures and IoU of the selections for each of ``PARTS``; no selections of guitar."""
    gaussians, cameras, masks, owners = _scene(name, data)
    views = list(cameras)[:: max(1, len(cameras) // VIEWS)][:VIEWS]
    everything = PageGaussians(gaussians, torch.arange(len(gaussians)))
    wanted = [_pictures(everything, masks, view) for view in views]
    rows = []
    for part in PARTS:
        most = max(1, len(gaussians) // part)
        row: Record = {"part": part}
        for way, shown in (
            ("merged", decimate(gaussians, most, owners)),
            ("largest", largest(gaussians, most)),
        ):
            found = [_pictures(shown, masks, view) for view in views]
            pairs = list(zip(found, wanted, strict=True))
            overlaps = [each for own, true in pairs for each in _overlaps(own[1], true[1])]
            row[way] = {
                "psnr": mean(_decibels(own[0], true[0]) for own, true in pairs),
                "iou": mean(overlaps) if overlaps else None,
            }
        rows.append(row)
    return {"gaussians": len(gaussians), "texts": masks.shape[1], "rows": rows}


def largest(gaussians: Gaussians, most: int) -> PageGaussians:
    """Return the Gaussians of the largest opacity times area instead."""
    covers = cover(gaussians.scales.numpy(), gaussians.opacities.numpy())
    rows = torch.from_numpy((-covers).argsort(kind="stable")[:most]).sort().values
    return PageGaussians(gaussians.select(rows), rows)


def _scene(name: str, data: Path) -> tuple[Gaussians, Cameras, Tensor, Tensor | None]:
    """Return Gaussians, labelled cameras, [N, T] what the labels select, and the things as pages use them."""
    if name == "guitar":
        gaussians = scoup.load_gaussians(data / name / "guitar.ply")
        return gaussians, scoup.choose_cameras(gaussians, count=VIEWS), torch.zeros(len(gaussians), 0), None
    if name == "desk":
        desk = RealScene.open(name, data)
        field = scoup.build(
            scoup.load_gaussians(data / name / "point_cloud.splat"), desk.cameras, desk.regions
        )
        field.text_encoder(data / name / "desk_words.npz")
        frames = desk.frames
    elif name.startswith("kitchen"):
        truth = Truth.open(data, 0.5)
        draw = make_draw(truth, int(name.rpartition("-")[2]))
        field = scoup.build(truth.gaussians, truth.cameras, draw.regions)
        field.text_encoder(data / "clip" / "text_vit_b16_laion2b.npz")
        frames = draw.frames
    else:
        demo = scene_of(name, 60_000)
        field = scoup.build(demo.gaussians, demo.building, demo.regions)
        words = demo.words.texts
        field.text_encoder(dict(zip(words, demo.text_vectors(words), strict=True)))
        frames = [(demo.labelled_frame(camera.name, LABELLED_LEVELS), camera) for camera in demo.held_out]
    texts = sorted({label for frame, _ in frames for label in frame.labels})
    owners = None if field.thing_table is None else field.thing_table.owners[:, len(field.levels) // 2]
    chosen = [field.select(field.question(text, always=True)).mask for text in texts]
    return field.gaussians, Cameras(camera for _, camera in frames), torch.stack(chosen, 1).float(), owners


def _pictures(shown: PageGaussians, masks: Tensor, view: Camera) -> tuple[Tensor, Tensor]:
    """Return colours [H, W, 3], and [H, W, T] where each selection is seen."""
    projection = raster.project(shown.gaussians, view)
    plain = replace(shown.gaussians, sh=shown.gaussians.sh[:, :1])
    colors = raster.render_colors(plain, view, projection)
    if not masks.shape[1]:
        return colors, torch.zeros(*colors.shape[:2], 0, dtype=torch.bool)
    return colors, raster.render_channels(projection, masks[shown.rows])[0] >= SEEN


def _decibels(found: Tensor, wanted: Tensor) -> float:
    error = (found.clamp(0, 1) - wanted.clamp(0, 1)).square().mean()
    return float(-10 * torch.log10(error.clamp(min=1e-12)))


def _overlaps(found: Tensor, wanted: Tensor) -> list[float]:
    """Return the IoU of each selection that is seen among all Gaussians."""
    both, either = (found & wanted).sum((0, 1)), (found | wanted).sum((0, 1))
    return [float(both[t] / either[t]) for t in range(wanted.shape[2]) if wanted[..., t].any()]
