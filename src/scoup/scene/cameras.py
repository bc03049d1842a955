"""Posed pinhole cameras, in OpenCV axes."""

from __future__ import annotations

import hashlib
import json
import math
import operator
import os
import unicodedata
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import overload

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import InputError, UnknownNameError, card, counted, listed

_PARALLEL = 1e-9  # sine of the angle between view direction and up below which the camera has no defined roll


@dataclass(frozen=True, eq=False, repr=False)
class Camera:
    """One posed pinhole camera. OpenCV axes: x right, y down, z forward; pixel centres at +0.5.

    Raises:
        InputError: a shape, size or number is not that of a camera.

    Example:
        >>> camera = scoup.Camera.look_at((4, 0, 1), (0, 0, 0), name="front.png", width=64, height=48, focal=60)
        >>> camera.viewmat.shape, camera.K.shape
        (torch.Size([4, 4]), torch.Size([3, 3]))
    """

    name: str
    """Image file name (with its extension where the source had one); unique within a collection."""
    viewmat: Tensor
    """[4, 4] float64 world-to-camera."""
    K: Tensor
    """[3, 3] float64 intrinsics in pixels of ``width`` x ``height``."""
    width: int
    height: int
    """Image size in pixels."""
    image_path: Path | None = None
    """The photograph, if there is one on disk. Its size may differ from width x height."""
    distortion: tuple[float, ...] = ()
    """OpenCV coefficients (k1, k2, p1, p2) of the *photograph*, empty for none. The camera itself is always an ideal
    pinhole; readers of images and region maps undistort with these (``io.cameras.undistort``). Only set where the user
    requested undistortion."""
    mask_path: Path | None = None
    """A mask of the photograph, if there is one: where it is 0, extraction makes no regions."""

    def __post_init__(self) -> None:
        for field, shape in (("viewmat", (4, 4)), ("K", (3, 3))):
            tensor = torch.as_tensor(getattr(self, field), dtype=torch.float64)
            if tuple(tensor.shape) != shape:
                raise InputError(
                    f"camera {self.name!r}: {field} has shape {list(tensor.shape)}, expected {list(shape)}"
                )
            if not torch.isfinite(tensor).all():
                raise InputError(f"camera {self.name!r}: {field} has values that are not finite")
            object.__setattr__(self, field, tensor)
        for field in ("width", "height"):
            object.__setattr__(self, field, self._whole(field))
        if self.width < 1 or self.height < 1:
            raise InputError(f"camera {self.name!r}: size {self.width} x {self.height} is not an image size")
        if self.fx <= 0 or self.fy <= 0:
            raise InputError(f"camera {self.name!r}: focal length ({self.fx}, {self.fy}) must be positive")
        determinant = float(torch.linalg.det(self.viewmat[:3, :3]))
        if not math.isclose(determinant, 1.0, abs_tol=1e-2):
            raise InputError(f"camera {self.name!r}: rotation has determinant {determinant:.3g}, expected 1")

    def _whole(self, field: str) -> int:
        """Return a number of pixels as an int, whatever type of number it is."""
        value = getattr(self, field)
        try:
            if int(value) == value:
                return int(value)
        except (TypeError, ValueError, OverflowError):
            pass
        raise InputError(f"camera {self.name!r}: {field} {value!r} is not a whole number of pixels")

    @classmethod
    def from_c2w(
        cls,
        name: str,
        c2w: Tensor | ArrayLike,
        K: Tensor | ArrayLike,
        width: int,
        height: int,
        image_path: Path | None = None,
    ) -> Camera:
        """Return a camera from its pose in the world, in place of the world-to-camera matrix.

        Args:
            name: image file name.
            c2w: [4, 4] or [3, 4] camera-to-world in OpenCV axes (for OpenGL axes, as nerfstudio has them, negate the
                second and third column first).
            K: [3, 3] intrinsics in pixels.
            width, height: image size in pixels.
            image_path: the photograph, if there is one on disk.

        Raises:
            InputError: a shape, size or number is not that of a camera.
        """
        pose = torch.as_tensor(c2w, dtype=torch.float64)
        if tuple(pose.shape) not in {(4, 4), (3, 4)}:
            raise InputError(f"camera {name!r}: c2w has shape {list(pose.shape)}, expected [4, 4] or [3, 4]")
        viewmat = torch.eye(4, dtype=torch.float64)
        viewmat[:3, :3] = pose[:3, :3].T
        viewmat[:3, 3] = -pose[:3, :3].T @ pose[:3, 3]
        return cls(name, viewmat, torch.as_tensor(K, dtype=torch.float64), width, height, image_path)

    @classmethod
    def look_at(
        cls,
        eye: ArrayLike,
        target: ArrayLike,
        name: str,
        width: int,
        height: int,
        focal: float,
        up: ArrayLike = (0.0, 0.0, 1.0),
    ) -> Camera:
        """Return a camera at ``eye`` that shows ``target`` in its image centre.

        Args:
            eye: [3] camera centre in world units.
            target: [3] the point in the middle of the image.
            name: image file name.
            width, height: image size in pixels.
            focal: focal length in pixels, along both axes.
            up: [3] world direction that points upwards in the image; its length does not matter.

        Raises:
            InputError: ``eye`` and ``target`` are the same point, the view direction is parallel to ``up``, or a size
                or number is not that of a camera.
        """
        center, aim, upwards = (np.asarray(vector, np.float64) for vector in (eye, target, up))
        distance, length = np.linalg.norm(aim - center), np.linalg.norm(upwards)
        if not 0 < distance < math.inf or not 0 < length < math.inf:
            raise InputError(
                f"camera {name!r}: no view direction from eye {center.tolist()} to target {aim.tolist()} "
                f"with up {upwards.tolist()}"
            )
        forward = (aim - center) / distance
        right = np.cross(forward, upwards)
        if np.linalg.norm(right) <= _PARALLEL * length:
            raise InputError(f"camera {name!r}: the view direction is parallel to up {upwards.tolist()}")
        right /= np.linalg.norm(right)
        viewmat = np.eye(4)
        viewmat[:3, :3] = np.stack([right, np.cross(forward, right), forward])
        viewmat[:3, 3] = -viewmat[:3, :3] @ center
        K = torch.tensor([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], dtype=torch.float64)
        return cls(name, torch.from_numpy(viewmat), K, width, height)

    def __repr__(self) -> str:
        position = ", ".join(f"{value:.4g}" for value in self.position.tolist())
        return f"Camera({self.name!r}, {self.width} x {self.height}, focal {self.fx:.4g}, at ({position}))"

    def fingerprint(self) -> str:
        """Return the SHA-256 of everything that decides what the camera sees; its name and photograph are left out."""
        digest = hashlib.sha256(json.dumps([self.width, self.height, self.distortion]).encode())
        digest.update(torch.cat([self.viewmat.flatten(), self.K.flatten()]).double().numpy().data)
        return digest.hexdigest()

    @property
    def fx(self) -> float:
        return float(self.K[0, 0])

    @property
    def fy(self) -> float:
        return float(self.K[1, 1])

    @property
    def cx(self) -> float:
        return float(self.K[0, 2])

    @property
    def cy(self) -> float:
        return float(self.K[1, 2])

    @property
    def stem(self) -> str:
        """Image name without folders, cut at its first dot: the stem of LangSplat's feature files."""
        return Path(self.name).name.split(".", 1)[0]

    @property
    def position(self) -> Tensor:
        """[3] float64 camera centre in world units."""
        return -self.viewmat[:3, :3].T @ self.viewmat[:3, 3]

    def pixels(self, points: Tensor) -> tuple[Tensor, Tensor]:
        """Project points [M, 3] of the world: pixels [M, 2] in the image and depths [M], float64 on the CPU. Points
        behind the camera have pixels, too."""
        seen = points.double().cpu() @ self.viewmat[:3, :3].T + self.viewmat[:3, 3]
        return (seen @ self.K.T)[:, :2] / seen[:, 2:], seen[:, 2]

    def shows(self, points: Tensor) -> Tensor:
        """Return a mask of the points [M, 3] in front of the camera and in its image, [M] boolean on the CPU."""
        pixels, depths = self.pixels(points)
        size = torch.tensor([self.width, self.height])
        return (depths > 0) & ((pixels >= 0) & (pixels < size)).all(1)

    def resized(self, width: int, height: int) -> Camera:
        """Return the camera at another image size. The intrinsics follow the image, each axis by its own factor."""
        scale = torch.tensor([width / self.width, height / self.height, 1.0], dtype=torch.float64)
        return replace(self, K=self.K * scale[:, None], width=width, height=height)

    def scaled(self, factor: float) -> Camera:
        """Return the camera with its image size multiplied by ``factor`` (rounded, at least one pixel).

        Raises:
            InputError: the factor is not a number above 0, or not finite.
        """
        if not isinstance(factor, Real) or not 0 < factor < math.inf:
            raise InputError(f"`scale={factor}`: must be a number above 0 and finite")
        return self.resized(max(1, round(self.width * factor)), max(1, round(self.height * factor)))

    def moved(self, rotation: ArrayLike, translation: ArrayLike, scale: float = 1.0) -> Camera:
        """Return the same camera in another world, in which the point x is at scale * (rotation x + translation).

        Args:
            rotation: [3, 3].
            translation: [3] in the units of the old world.
            scale: above 0.

        Raises:
            InputError: ``rotation`` is none.
        """
        turn = torch.as_tensor(rotation, dtype=torch.float64)
        shift = torch.as_tensor(translation, dtype=torch.float64)
        viewmat = self.viewmat.clone()
        viewmat[:3, :3] = self.viewmat[:3, :3] @ turn.T
        viewmat[:3, 3] = scale * (self.viewmat[:3, 3] - viewmat[:3, :3] @ shift)
        return replace(self, viewmat=viewmat)


class Cameras:
    """An ordered, immutable collection of cameras with unique names, found by index or by name.

    Example:
        >>> cameras = scoup.load_cameras("scene")
        >>> cameras["view_01"].name  # with or without extension
        'view_01.png'
    """

    def __init__(self, cameras: Iterable[Camera]) -> None:
        self._cameras = tuple(cameras)
        self._by_name: dict[str, Camera] = {}
        for camera in self._cameras:
            if camera.name in self._by_name:
                raise InputError(f"two cameras are named {camera.name!r}; names must be unique")
            self._by_name[camera.name] = camera

    def __repr__(self) -> str:
        return f"Cameras({len(self)}: {listed(self.names, 4)})"

    def _repr_html_(self) -> str:
        from scoup.scene.previews import cameras_preview

        sizes = [f"{width} x {height}" for width, height in dict.fromkeys((c.width, c.height) for c in self)]
        facts = {"names": listed(self.names, 4), "sizes": listed(sizes, 4), "picture": "from above"}
        viewmats = torch.stack([camera.viewmat for camera in self]) if len(self) else torch.zeros(0, 4, 4)
        return card(counted(len(self), "camera"), facts, cameras_preview(viewmats))

    def __len__(self) -> int:
        return len(self._cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self._cameras)

    @overload
    def __getitem__(self, key: int | str) -> Camera: ...
    @overload
    def __getitem__(self, key: slice) -> Cameras: ...
    def __getitem__(self, key: int | str | slice) -> Camera | Cameras:
        """Return a camera by index, or by name (with or without extension). A slice gives a collection."""
        if isinstance(key, slice):
            return Cameras(self._cameras[key])
        if not isinstance(key, str):
            return self._cameras[operator.index(key)]
        if key in self._by_name:
            return self._by_name[key]
        wanted = unicodedata.normalize("NFC", key)
        for same in (_whole_names, _stems):
            matches = [camera for camera in self._cameras if wanted in same(camera)]
            if len(matches) == 1:
                return matches[0]
        raise UnknownNameError("camera", key, self.names)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self._cameras)

    def select(self, chosen: Callable[[Camera], bool] | Iterable[str | int]) -> Cameras:
        """Return the cameras for which ``chosen`` is true, or the ones that it lists by name or index, in its order."""
        if callable(chosen):
            return Cameras(camera for camera in self._cameras if chosen(camera))
        return Cameras(self[key] for key in chosen)

    def scaled(self, factor: float) -> Cameras:
        """Return all cameras at other image sizes (``Camera.scaled``)."""
        return Cameras(camera.scaled(factor) for camera in self._cameras)


def _whole_names(camera: Camera) -> tuple[str, ...]:
    """Return the name with and without its extension."""
    name = unicodedata.normalize("NFC", camera.name)
    return name, os.path.splitext(name)[0]


def _stems(camera: Camera) -> tuple[str, ...]:
    """Return the name without folders, without its extension and cut at its first dot."""
    name = Path(unicodedata.normalize("NFC", camera.name))
    return name.name, name.stem, camera.stem
