"""The reference's projection and colours against gsplat's own."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from raster.real_scenes import load_camera, load_scene
from scoup import raster
from scoup.raster.presets import raster_preset
from scoup.raster.projection import project_gaussians
from scoup.scene import Camera, Gaussians
from support import make_camera, random_gaussians


def _gsplat_projection(gaussians: Gaussians, camera: Camera, near: float):
    implementation = pytest.importorskip("gsplat.cuda._torch_impl")
    covariances, _ = implementation._quat_scale_to_covar_preci(
        gaussians.quats.double(), gaussians.scales.double(), compute_covar=True, compute_preci=False
    )
    return implementation._fully_fused_projection(
        gaussians.means.double(),
        covariances,
        camera.viewmat[None],
        camera.K[None],
        camera.width,
        camera.height,
        near_plane=near,
    )


def _compare_with_gsplat(gaussians: Gaussians, camera: Camera) -> int:
    radii, means2d, depths, conics, _ = _gsplat_projection(gaussians, camera, 0.01)
    ours = project_gaussians(gaussians, camera, raster_preset("gsplat"))
    ids = ours.ids
    assert (torch.as_tensor(radii)[0][ids].reshape(len(ids), -1) > 0).all()
    assert torch.allclose(ours.means2d, means2d[0][ids], rtol=1e-9, atol=1e-6)
    assert torch.allclose(ours.depths, depths[0][ids], rtol=1e-9)
    xx, xy, yy = ours.covariances.unbind(1)
    conic = torch.stack([yy, -xy, xx], 1) / ours.determinants[:, None]
    assert torch.allclose(conic, conics[0][ids], rtol=1e-5, atol=1e-9)
    return len(ids)


def test_projection_equals_gsplats_on_random_scenes():
    for seed in range(5):
        assert _compare_with_gsplat(random_gaussians(300, seed), make_camera(64, 48, 50.0, seed)) > 50


@pytest.mark.data
def test_projection_equals_gsplats_on_garden(data_folder: Path):
    gaussians = load_scene(data_folder, "garden")
    for number in range(3):
        camera = load_camera(data_folder, "garden", number, 1, gaussians)
        assert _compare_with_gsplat(gaussians, camera) > 1000


def test_colours_follow_gsplats_spherical_harmonics():
    implementation = pytest.importorskip("gsplat.cuda._torch_impl")
    for degree in range(5):
        gaussians, camera = random_gaussians(50, degree, degree=degree), make_camera(seed=2)
        directions = gaussians.means - camera.position.float()
        expected = (implementation._spherical_harmonics(degree, directions, gaussians.sh) + 0.5).clamp(min=0)
        assert torch.allclose(raster.view_colors(gaussians, camera), expected, atol=1e-5)
