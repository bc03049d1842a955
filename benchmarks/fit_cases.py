"""Scenes that fit and scenes that do not, for ``benchmarks.fit``: what is done to splat, cameras and photographs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial.transform import Rotation

from scoup.io import load_image, save_png
from scoup.raster import render_colors
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.uplift.fit import views_tried

Array = NDArray[np.float64]

AXES_SWAPPED = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]])  # applied_transform of ns-process-data
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
MIRRORED = np.diag([-1.0, 1, 1])
OPENGL = np.diag([1.0, -1, -1, 1])


@dataclass(frozen=True, eq=False)
class FitScene:
    """A splat and cameras with photographs on disk.

    Attributes:
        name: of the scene.
        gaussians, cameras: of the scene; every camera has a photograph.
        other: the splat of another scene.
        folder: where changed photographs are written.
    """

    name: str
    gaussians: Gaussians
    cameras: list[Camera]
    other: Gaussians
    folder: Path

    def with_cameras(self, change: Callable[[Camera], Camera]) -> FitScene:
        return replace(self, cameras=[change(camera) for camera in self.cameras])

    def with_photographs(self, change: Callable[[Array, np.random.Generator], Array]) -> FitScene:
        """The photographs of the views that are tried, changed: [H, W, 3] in 0..1."""
        folder = self.folder / f"changed-{len(list(self.folder.iterdir()))}"
        written = {}
        for position, camera in enumerate(views_tried(self.cameras)):
            changed = change(load_image(camera).numpy() / 255, np.random.default_rng(position))
            path = folder / f"{camera.name}.png"
            save_png((changed.clip(0, 1) * 255 + 0.5).astype(np.uint8), path)
            written[camera.name] = path
        return self.with_cameras(lambda camera: replace(camera, image_path=written.get(camera.name)))


def photographed(
    gaussians: Gaussians, cameras: Iterable[Camera], folder: Path, background: float = 0.0
) -> list[Camera]:
    """The cameras with renders over a grey background as their photographs."""
    found = []
    for camera in cameras:
        image = render_colors(gaussians, camera, background=background)
        path = folder / f"{camera.name}.png"
        save_png((image.numpy() * 255 + 0.5).astype(np.uint8), path)
        found.append(replace(camera, image_path=path))
    return found


def damaged_splat(scene: FitScene) -> FitScene:
    """Half of the Gaussians, in other colours and moved by a hundredth of the scene."""
    random = torch.Generator().manual_seed(0)
    found = scene.gaussians
    found = found.select((torch.rand(len(found), generator=random) < 0.5).nonzero()[:, 0])
    extent = (found.means - found.means.median(0).values).norm(dim=1).median()
    moved = found.means + 0.01 * extent * torch.randn(found.means.shape, generator=random)
    colors = found.sh[:, :1] + 0.5 * torch.randn(found.sh[:, :1].shape, generator=random)
    return replace(scene, gaussians=replace(found, means=moved, sh=colors))


def exposed(image: Array, rng: np.random.Generator) -> Array:
    """Another exposure, contrast and white balance."""
    return image ** rng.uniform(0.6, 1.7) * rng.uniform(0.4, 1.6) * rng.uniform(0.7, 1.3, 3)


def blurred(image: Array, rng: np.random.Generator) -> Array:
    """Moved while the shutter was open, out of focus, and noisy."""
    width = image.shape[1] / 320
    moved = ndimage.uniform_filter1d(image, max(1, round(5 * width)), axis=1)
    return ndimage.gaussian_filter(moved, (width, width, 0)) + rng.normal(0, 0.05, image.shape)


def occluded(image: Array, rng: np.random.Generator) -> Array:
    """A third of the photograph is taken up by something that the splat lacks."""
    height, width = image.shape[:2]
    changed = image.copy()
    left = int(rng.uniform(0, 2 / 3) * width)
    stripes = 0.5 + 0.5 * np.sin(np.arange(height) * 40 / height)
    changed[:, left : left + width // 3] = stripes[:, None, None] * rng.uniform(0, 1, 3)
    return changed


def halved(image: Array, rng: np.random.Generator) -> Array:
    """Half the size of the camera."""
    return image[: image.shape[0] // 2 * 2 : 2, : image.shape[1] // 2 * 2 : 2]


def some_others(scene: FitScene) -> FitScene:
    """Two of the eight photographs show something else."""
    tried = [camera.name for camera in views_tried(scene.cameras)][::5]

    def spoilt(camera: Camera) -> Camera:
        if camera.name not in tried:
            return camera
        shape = (camera.height, camera.width, 3)
        noise = ndimage.gaussian_filter(np.random.default_rng(0).random(shape), (4, 4, 0))
        path = scene.folder / "others" / f"{camera.name}.png"
        noise = (noise - noise.min()) / (noise.max() - noise.min())
        save_png((noise * 255).astype(np.uint8), path, overwrite=True)
        return replace(camera, image_path=path)

    return scene.with_cameras(spoilt)


def moved_world(scene: FitScene, rotation: Array, scale: float = 1.0, shift: Array | None = None) -> FitScene:
    """The splat in another frame: x' = scale * (rotation x) + shift. A mirrored one keeps its quaternions."""
    found = scene.gaussians
    means = scale * found.means.double().numpy() @ rotation.T + (np.zeros(3) if shift is None else shift)
    quats = found.quats.double().numpy()
    if np.linalg.det(rotation) > 0:
        turned = Rotation.from_matrix(rotation) * Rotation.from_quat(quats[:, [1, 2, 3, 0]])
        quats = turned.as_quat()[:, [3, 0, 1, 2]]
    moved = replace(
        found,
        means=torch.from_numpy(means).float(),
        quats=torch.from_numpy(quats).float(),
        scales=found.scales * scale,
    )
    return replace(scene, gaussians=moved)


def normalised_world(scene: FitScene) -> FitScene:
    """As nerfstudio centres and scales: all camera positions lie within -1..1."""
    positions = np.stack([camera.position.numpy() for camera in scene.cameras])
    centre = positions.mean(0)
    scale = 1 / np.abs(positions - centre).max()
    return moved_world(scene, np.eye(3), scale, -scale * centre)


def shifted_world(scene: FitScene) -> FitScene:
    positions = np.stack([camera.position.numpy() for camera in scene.cameras])
    return moved_world(scene, np.eye(3), 1.0, -positions.mean(0))


def zoomed(factor: float) -> Callable[[FitScene], FitScene]:
    """Focal lengths that are wrong by a factor."""

    def change(camera: Camera) -> Camera:
        K = camera.K.clone()
        K[0, 0] *= factor
        K[1, 1] *= factor
        return replace(camera, K=K)

    return lambda scene: scene.with_cameras(change)


def renamed(order: Callable[[int], NDArray[np.int64]]) -> Callable[[FitScene], FitScene]:
    """Photographs that belong to other cameras."""

    def change(scene: FitScene) -> FitScene:
        positions = order(len(scene.cameras))
        paths = [scene.cameras[position].image_path for position in positions]
        cameras = [
            replace(camera, image_path=path) for camera, path in zip(scene.cameras, paths, strict=True)
        ]
        return replace(scene, cameras=cameras)

    return change


def half_intrinsics(camera: Camera) -> Camera:
    """The intrinsics belong to photographs of half the size."""
    return replace(camera, width=2 * camera.width, height=2 * camera.height)


RIGHT: dict[str, Callable[[FitScene], FitScene]] = {
    "as it is": lambda scene: scene,
    "a bad splat": damaged_splat,
    "other exposures": lambda scene: scene.with_photographs(exposed),
    "blurred, noisy photographs": lambda scene: scene.with_photographs(blurred),
    "a third of each photograph hidden": lambda scene: scene.with_photographs(occluded),
    "photographs of half the size": lambda scene: scene.with_photographs(halved),
    "two photographs of something else": some_others,
}
"""What must stay silent."""

WRONG: dict[str, Callable[[FitScene], FitScene]] = {
    "splat of another scene": lambda scene: replace(scene, gaussians=scene.other),
    "axes swapped": lambda scene: moved_world(scene, AXES_SWAPPED),
    "another axis up": lambda scene: moved_world(scene, Z_UP),
    "centred and scaled world": normalised_world,
    "shifted world": shifted_world,
    "scaled world (2)": lambda scene: moved_world(scene, np.eye(3), 2.0),
    "mirrored world": lambda scene: moved_world(scene, MIRRORED),
    "OpenGL camera axes": lambda scene: scene.with_cameras(
        lambda camera: replace(camera, viewmat=torch.from_numpy(OPENGL) @ camera.viewmat)
    ),
    "poses not inverted": lambda scene: scene.with_cameras(
        lambda camera: replace(camera, viewmat=torch.linalg.inv(camera.viewmat))
    ),
    "photographs one off": renamed(lambda count: np.roll(np.arange(count), -1)),
    "photographs shuffled": renamed(lambda count: np.random.default_rng(0).permutation(count)),
    "focal lengths twice as long": zoomed(2.0),
    "focal lengths half as long": zoomed(0.5),
    "focal lengths a fifth too long": zoomed(1.2),
    "intrinsics of half the size": lambda scene: scene.with_cameras(half_intrinsics),
}
"""What should be refused, or at least warned of."""
