"""What we compare with on the same device: gsplat, decoding to D channels, and the paper's solver as one writes it."""

from __future__ import annotations

import importlib
import importlib.util
import os
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from benchmarks.gpu.timing import Unavailable
from scoup import raster
from scoup.bench import Workload, random_scene_cameras, random_scene_gaussians
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians

NEAR = raster.RASTER_PRESETS["gsplat"].near


class Gsplat:
    """gsplat's rasteriser (github.com/nerfstudio-project/gsplat) behind the names used here."""

    def __init__(self, module: ModuleType) -> None:
        self._module = module
        self._cameras: dict[Camera, tuple[Tensor, Tensor]] = {}  # on the device, so that copies are not timed
        self.version = str(getattr(module, "__version__", "unknown"))

    @classmethod
    def found(cls, device: torch.device) -> Gsplat:
        """gsplat, tried once: its wheel compiles itself with nvcc when first used, which may take minutes.

        Raises:
            Unavailable: it is not installed, there is no GPU, or a small render fails.
        """
        if importlib.util.find_spec("gsplat") is None:
            raise Unavailable("gsplat is not installed (pip install gsplat; it needs nvcc)")
        if device.type != "cuda":
            raise Unavailable("gsplat needs a CUDA device")
        # The same in all processes: with other flags each would compile it anew.
        major, minor = torch.cuda.get_device_capability(device)
        os.environ.setdefault("TORCH_CUDA_ARCH_LIST", f"{major}.{minor}")
        peer = cls(importlib.import_module("gsplat"))
        gaussians = random_scene_gaussians(100).to(device)
        try:
            peer.render(gaussians, random_scene_cameras(1, 32, 32)[0], torch.rand(100, 3, device=device))
            torch.cuda.synchronize()
        except Exception as error:
            raise Unavailable(f"gsplat {peer.version} does not work here: {str(error)[:300]}") from error
        return peer

    def render(
        self,
        gaussians: Gaussians,
        camera: Camera,
        values: Tensor,  # [N, C]
        packed: bool = False,
        channels_at_once: int = 32,
    ) -> Tensor:
        """[H, W, C] of any values; with gradients where ``values`` asks for them."""
        if camera not in self._cameras:
            matrices = camera.viewmat.float()[None], camera.K.float()[None]
            self._cameras[camera] = matrices[0].to(values.device), matrices[1].to(values.device)
        arguments = self.arguments(gaussians, camera, values, packed, channels_at_once)
        arguments["viewmats"], arguments["Ks"] = self._cameras[camera]
        return self._module.rasterization(**arguments)[0][0]

    @staticmethod
    def arguments(
        gaussians: Gaussians, camera: Camera, values: Tensor, packed: bool, channels_at_once: int
    ) -> dict[str, Any]:
        """Of ``gsplat.rasterization``; values are colours as they stand, no spherical harmonics are evaluated."""
        return {
            "means": gaussians.means,
            "quats": gaussians.quats,
            "scales": gaussians.scales,
            "opacities": gaussians.opacities,
            "colors": values,
            "viewmats": camera.viewmat.float()[None],
            "Ks": camera.K.float()[None],
            "width": camera.width,
            "height": camera.height,
            "near_plane": NEAR,
            "packed": packed,
            "channel_chunk": channels_at_once,
        }


def dense_uplift(peer: Gsplat, work: Workload, embeddings: list[Tensor], out: Tensor, channels: int) -> None:
    """Add a view's embeddings to Gaussians by the peer's backward: the gradient of sum over p of F(p) . I(p) with
    respect to the values rendered is sum over p of e_i(p) F(p), which is dense uplift.

    Args:
        peer: the rasteriser.
        work: scene, view and labels [S, H, W], each pixel with a region.
        embeddings: per level, [R, D] of the view's regions.
        out: [S, N, D], added to.
        channels: in a call. gsplat draws 32 at a time anyway; fewer calls project and sort less often, more calls need
            less memory, and their gradients are not put together from parts.
    """
    for level, rows in enumerate(embeddings):
        labels = work.labels[level].long()
        for first in range(0, rows.shape[1], channels):
            own = rows[:, first : first + channels]
            values = torch.zeros(out.shape[1], own.shape[1], device=out.device, requires_grad=True)
            image = peer.render(work.gaussians, work.camera, values)
            (gradient,) = torch.autograd.grad(image, values, own[labels])
            out[level, :, first : first + channels] += gradient


def decoded_cosines(coefficients: Tensor, codebook: Tensor, queries: Tensor) -> Tensor:
    """[S, Q, H, W] cosines the long way, as LangSplatV2 takes it: coefficient maps [S, H, W, L] written out, decoded to
    maps of D channels, these normalised and multiplied with the queries [Q, D].
    """
    found = []
    for level, own in enumerate(coefficients):
        features = torch.nn.functional.normalize(own @ codebook[level], dim=-1)
        found.append((features @ queries.T).permute(2, 0, 1))
    return torch.stack(found)


def plain_adam(
    rows: Tensor, atoms: Tensor, k: int, epochs: int, learning_rate: float
) -> tuple[Tensor, Tensor]:
    """The paper's solver in its plain form (method.md, stage 1): dense logits, D-dimensional reconstructions, autograd.

    Args:
        rows: [R, D] float32 unit embeddings.
        atoms: [L, D] start of the codebook.
        k, epochs, learning_rate: of codes and optimiser.

    Returns:
        atoms [L, D] and weights [R, L], K of them in a row, summing to 1.
    """
    atoms = atoms.clone().requires_grad_()
    logits = (rows @ torch.nn.functional.normalize(atoms.detach(), dim=1).T * 4.0).requires_grad_()
    optimizer = torch.optim.Adam([logits, atoms], lr=learning_rate)
    for _ in range(epochs):
        optimizer.zero_grad()
        decoded = _sparse(logits, k) @ atoms
        (1 - torch.nn.functional.cosine_similarity(decoded, rows, dim=1)).mean().backward()
        optimizer.step()
    return atoms.detach(), _sparse(logits.detach(), k)


def _sparse(logits: Tensor, k: int) -> Tensor:
    """Softmax over the k largest logits of each row."""
    values, indices = torch.topk(logits, k, dim=1)
    return torch.zeros_like(logits).scatter(1, indices, torch.softmax(values, dim=1))
