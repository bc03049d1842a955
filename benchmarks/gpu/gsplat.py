"""gsplat, with which we are compared on the same device, and dense uplift by its backward."""

from __future__ import annotations

import importlib
import importlib.util
import os
from collections.abc import Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from benchmarks.gpu.stage import PRESET, Stage, Unavailable
from scoup import raster
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup_lab.bench import Workload, random_scene_cameras, random_scene_gaussians


def compile_gsplat(stage: Stage) -> None:
    """Add a row; where it fails, all others that need gsplat have the same reason. Its wheel compiles itself
    with nvcc when first used, for minutes.
    """
    os.environ.setdefault("MAX_JOBS", str(max(1, (os.cpu_count() or 1) - 2)))

    def compiled() -> None:
        # More channels than are drawn at a time.
        values = torch.zeros(100, 40, device=stage.device, requires_grad=True)
        gaussians, camera = random_scene_gaussians(100).to(stage.device), random_scene_cameras(1, 32, 32)[0]
        image = render(load_gsplat(stage), gaussians, camera, values)
        (gradient,) = torch.autograd.grad(image, values, torch.ones_like(image))
        if not float(gradient.sum()) > 0:
            raise Unavailable("the gradients of gsplat's render are zero")

    row = stage.once("gsplat: compiled, a render and its backward", compiled)
    stage.no_gsplat = row.get("reason", "")


def load_gsplat(stage: Stage) -> Any:
    """Return the module (github.com/nerfstudio-project/gsplat), or Unavailable and why."""
    if stage.no_gsplat:
        raise Unavailable(stage.no_gsplat)
    if importlib.util.find_spec("gsplat") is None:
        raise Unavailable("gsplat is not installed (pip install gsplat; it needs nvcc)")
    if stage.device.type != "cuda":
        raise Unavailable("gsplat needs a CUDA device")
    # The same in all processes: with other flags each would compile it again.
    major, minor = torch.cuda.get_device_capability(stage.device)
    os.environ.setdefault("TORCH_CUDA_ARCH_LIST", f"{major}.{minor}")
    return importlib.import_module("gsplat")


@cache
def matrices(camera: Camera, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return both matrices of a camera on the device, so that copies are not timed."""
    return camera.viewmat.float()[None].to(device), camera.K.float()[None].to(device)


def render(
    module: Any, gaussians: Gaussians, camera: Camera, values: Tensor, packed: bool = False, at_once: int = 32
) -> Tensor:
    """Return [H, W, C] of any values [N, C], with gradients where they require them. No spherical harmonics."""
    viewmats, intrinsics = matrices(camera, values.device)
    images, *_ = module.rasterization(
        means=gaussians.means, quats=gaussians.quats, scales=gaussians.scales, opacities=gaussians.opacities,
        colors=values, viewmats=viewmats, Ks=intrinsics, width=camera.width, height=camera.height,
        near_plane=raster.RASTER_PRESETS[PRESET].near, packed=packed, channel_chunk=at_once,
    )  # fmt: skip
    return images[0]


def dense_uplift(
    module: Any, work: Workload, embeddings: Sequence[Tensor], out: Tensor, channels: int
) -> None:
    """Add to ``out`` [S, N, D] the dense sums of a view, w_i = sum over p of e_i(p) F(p), by gsplat's backward.

    They are the gradient of sum over p of F(p) . I(p) with respect to the values rendered. F is given per level as
    embeddings [R, D] of regions; each pixel must have one. ``channels`` go into a call: fewer calls sort less often,
    more calls need less memory.
    """
    for level, rows in enumerate(embeddings):
        labels = work.labels[level].long()
        for first in range(0, rows.shape[1], channels):
            own = rows[:, first : first + channels]
            values = torch.zeros(out.shape[1], own.shape[1], device=out.device, requires_grad=True)
            image = render(module, work.gaussians, work.camera, values)
            (gradient,) = torch.autograd.grad(image, values, own[labels])
            out[level, :, first : first + channels] += gradient
