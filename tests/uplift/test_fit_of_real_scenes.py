"""Right and wrong cameras of real scenes. The bounds of ``uplift/fit.py`` were tuned on the first three."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

import scoup
from scoup.scene import Camera, Gaussians
from scoup.uplift.fit import Verdict, measure_fit
from uplift.test_fit import mirrored, with_focal_lengths, with_photographs_of

pytestmark = [pytest.mark.data, pytest.mark.slow, pytest.mark.timeout(900)]
REAL = [f"real/{name}-20" for name in ("table", "shelves", "hall", "yard")]
SPLATS = {
    "kitchen": "kitchen/scene/model.splat",
    **{name: f"{name}/point_cloud.splat" for name in ("desk", *REAL)},
}
OTHERS = dict(zip(SPLATS, (*tuple(SPLATS)[1:], "kitchen"), strict=True))
EYE = np.eye(3)


def normalised(cameras: Sequence[Camera], scale: float) -> list[Camera]:
    middle = torch.stack([camera.position for camera in cameras]).mean(0)
    return [camera.moved(EYE, -middle, scale) for camera in cameras]


def converted(cameras: Sequence[Camera], convert: Callable[[torch.Tensor], torch.Tensor]) -> list[Camera]:
    return [replace(camera, viewmat=convert(camera.viewmat)) for camera in cameras]


OPENGL = torch.diag(torch.tensor([1.0, -1, -1, 1])).double()
WRONG: dict[str, Callable[[Gaussians, list[Camera]], tuple[Gaussians, list[Camera]]]] = {
    **{f"mirrored, {'xyz'[axis]}": lambda g, c, axis=axis: (mirrored(g, axis), c) for axis in range(3)},
    **{
        f"focal lengths of {factor}": lambda g, c, factor=factor: (g, with_focal_lengths(c, factor))
        for factor in (0.5, 0.9, 0.95, 1.05, 1.1, 2.0)
    },
    "photographs one off": lambda g, c: (g, with_photographs_of(c, [*c[1:], c[0]])),
    "photographs in reverse": lambda g, c: (g, with_photographs_of(c, c[::-1])),
    "normalised": lambda g, c: (g, normalised(c, 0.7)),
    "other units": lambda g, c: (g, [camera.moved(EYE, np.zeros(3), 0.1) for camera in c]),
    "axes swapped": lambda g, c: (g, [camera.moved(EYE[[1, 2, 0]], np.zeros(3)) for camera in c]),
    "axes of OpenGL": lambda g, c: (g, converted(c, lambda viewmat: OPENGL @ viewmat)),
    "poses inverted": lambda g, c: (g, converted(c, torch.linalg.inv)),
}


def read(name: str, data: Path) -> tuple[Gaussians, list[Camera]]:
    if not (data / SPLATS[name]).exists():
        pytest.skip(f"no {name} in {data}")
    return scoup.load_gaussians(data / SPLATS[name]), list(scoup.load_cameras(data / name))


@pytest.mark.parametrize("name", SPLATS)
def test_no_wrong_scene_passes(name: str, data_folder: Path) -> None:
    gaussians, cameras = read(name, data_folder)
    found = {wrong: measure_fit(*change(gaussians, cameras)) for wrong, change in WRONG.items()}
    found["another scene"] = measure_fit(read(OTHERS[name], data_folder)[0], cameras)
    assert {wrong for wrong, fit in found.items() if fit.verdict is not Verdict.HOPELESS} == set()


@pytest.mark.parametrize("name", SPLATS)
def test_no_right_scene_is_refused(name: str, data_folder: Path, tmp_path: Path) -> None:
    """Nor warned of: with a tenth of the Gaussians, without the surroundings, with poor photographs."""
    gaussians, cameras = read(name, data_folder)
    distance = (gaussians.means - gaussians.means.median(0).values).norm(dim=1)
    tenth = torch.randperm(len(gaussians), generator=torch.Generator().manual_seed(0))[: len(gaussians) // 10]
    poor = []
    for number, camera in enumerate(cameras):
        assert camera.image_path is not None
        pixels = np.asarray(Image.open(camera.image_path).convert("RGB")) * (1.8 if number % 2 else 0.5)
        pixels[:, : pixels.shape[1] // 4] = 90  # somebody stands there
        path = tmp_path / f"{number}.jpg"
        Image.fromarray(pixels.clip(0, 255).astype(np.uint8)).save(path, quality=40)
        poor.append(replace(camera, image_path=path))
    found = {
        "as it is": measure_fit(gaussians, cameras),
        "every third photograph": measure_fit(gaussians, cameras[::3]),
        "a tenth of the Gaussians": measure_fit(gaussians.select(tenth), cameras),
        "the nearer half": measure_fit(gaussians.select(distance < distance.median()), cameras),
        "poor photographs": measure_fit(gaussians, poor),
        "focal lengths of 0.99": measure_fit(gaussians, with_focal_lengths(cameras, 0.99)),
    }
    assert {right for right, fit in found.items() if fit.verdict is not Verdict.FITS} == set()
