"""Instances that follow from regions of photographs, and how well they can fit marked objects."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

import scoup
from benchmarks.study import Record
from scoup import raster
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import RegionMap, Regions
from scoup.uplift.rasterise import region_sums
from scoup.uplift.things import find_things
from scoup_lab.data.labels import LabelledFrame

COVERS = 0.5  # share of a pixel's opacity that the thing it belongs to contributes

Labels = NDArray[np.int16]


def instances(
    gaussians: Gaussians,
    cameras: scoup.Cameras,
    maps: Mapping[str, Mapping[str, Labels]],
    frames: list[tuple[LabelledFrame, Camera]],
) -> Record:
    """Return frame -> name -> IoU of the best thing, and of the best union, of all frames of a name together."""
    regions = Regions.from_maps({
        name: {
            level: RegionMap(torch.from_numpy(of), torch.ones(int(of.max()) + 1, 1)) for level, of in by_level.items()
        }
        for name, by_level in maps.items()
    })  # fmt: skip
    sums = region_sums(gaussians, cameras, regions)
    stacked = [regions.embeddings(level) for level in sums.levels]
    sums = sums.select(list(sums.views), tuple(rows for _, rows in stacked))
    table = find_things(sums, [embeddings for embeddings, _ in stacked]).table
    views = [_thing_masks(gaussians, camera, table.owners, len(table.levels)) for _, camera in frames]
    found: Record = {frame.name: {} for frame, _ in frames}
    for name in sorted({label for frame, _ in frames for label in frame.masks}):
        mine = [
            (f.name, f.masks[name].numpy(), v)
            for (f, _), v in zip(frames, views, strict=True)
            if name in f.masks
        ]
        ious = np.stack([_overlaps(truth, masks) for _, truth, masks in mine])  # [V, T]
        best = int(ious.mean(0).argmax())
        touching = ious.any(0)
        near = [(truth, masks[touching]) for _, truth, masks in mine]
        union = _grow([masks[best] for _, _, masks in mine], near)
        for (frame, *_), thing, together in zip(mine, ious[:, best], union, strict=True):
            found[frame][name] = [float(thing), float(together)]
    return {"things": len(table.levels), "ious": found}


def _thing_masks(gaussians: Gaussians, camera: Camera, owners: Tensor, count: int) -> NDArray[np.bool_]:
    """Return [T, H, W] the pixels that each thing contributes most of."""
    projection = raster.project(gaussians, camera)
    parts = []
    for chunk in torch.arange(count).split(32):
        members = (owners[:, :, None] == chunk).any(1).float()
        image, alpha = raster.render_channels(projection, members)
        parts.append((image > COVERS * alpha.clamp(min=0.1)[..., None]).permute(2, 0, 1).numpy())
    return np.concatenate(parts)


def _overlaps(truth: NDArray[np.bool_], masks: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return [T] the IoU of a mask [H, W] with masks [T, H, W]."""
    shared = masks[:, truth].sum(1)
    return shared / np.maximum(masks.sum((1, 2)) + truth.sum() - shared, 1)


def _grow(
    masks: list[NDArray[np.bool_]], views: list[tuple[NDArray[np.bool_], NDArray[np.bool_]]]
) -> list[float]:
    """Add things to masks, one per view, while the mean IoU grows; return the IoUs.

    ``views``: per view what is marked [H, W], and the things [T, H, W] that touch it in some view; others cannot help.
    """
    ious = [float(_overlaps(truth, mask[None])[0]) for mask, (truth, _) in zip(masks, views, strict=True)]
    while True:
        pairs = zip(masks, views, strict=True)
        tried = np.stack([_overlaps(truth, mask | things) for mask, (truth, things) in pairs])
        if not tried.size:
            return ious
        best = int(tried.mean(0).argmax())
        if tried[:, best].mean() <= np.mean(ious) + 1e-6:
            return ious
        ious = tried[:, best].tolist()
        masks = [mask | things[best] for mask, (_, things) in zip(masks, views, strict=True)]
