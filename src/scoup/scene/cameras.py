"""Posed pinhole cameras."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import overload

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError


@dataclass(frozen=True, eq=False)
class Camera:
    """One pinhole view. OpenCV axes: x right, y down, z forward; pixel centres at +0.5.

    Attributes:
        name: image file name (with its extension where the source had one); unique within a collection.
        viewmat: [4, 4] float64 world-to-camera.
        K: [3, 3] float64 intrinsics in pixels of ``width`` x ``height``.
        width, height: image size in pixels.
        image_path: the photograph, if there is one on disk. Its size may differ from width x height.
        distortion: OpenCV coefficients (k1, k2, p1, p2) of the *photograph*, empty for none. The camera itself
            is always the ideal pinhole; readers of images and region maps undistort by these
            (see ``io.undistort``). Only set where undistortion was asked for.

    Raises:
        InputError: if a shape, size or number cannot be a camera.
    """

    name: str
    viewmat: Tensor  # [4, 4]
    K: Tensor  # [3, 3]
    width: int
    height: int
    image_path: Path | None = None
    distortion: tuple[float, ...] = ()

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
        if self.width < 1 or self.height < 1:
            raise InputError(f"camera {self.name!r}: size {self.width} x {self.height} is not an image size")
        if self.fx <= 0 or self.fy <= 0:
            raise InputError(f"camera {self.name!r}: focal length ({self.fx}, {self.fy}) must be positive")
        determinant = float(torch.linalg.det(self.viewmat[:3, :3]))
        if not math.isclose(determinant, 1.0, abs_tol=1e-2):
            raise InputError(f"camera {self.name!r}: rotation has determinant {determinant:.3g}, expected 1")

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

    def resized(self, width: int, height: int) -> Camera:
        """The same view at another image size; the intrinsics follow the image (each axis by its own factor)."""
        scale = torch.tensor([width / self.width, height / self.height, 1.0], dtype=torch.float64)
        return replace(self, K=self.K * scale[:, None], width=width, height=height)


class Cameras:
    """An ordered, immutable collection of cameras with unique names, found by index or by name."""

    def __init__(self, cameras: Iterable[Camera]) -> None:
        self._cameras = tuple(cameras)
        self._by_name: dict[str, Camera] = {}
        for camera in self._cameras:
            if camera.name in self._by_name:
                raise InputError(f"two cameras are named {camera.name!r}; names must be unique")
            self._by_name[camera.name] = camera

    def __len__(self) -> int:
        return len(self._cameras)

    def __iter__(self) -> Iterator[Camera]:
        return iter(self._cameras)

    @overload
    def __getitem__(self, key: int | str) -> Camera: ...
    @overload
    def __getitem__(self, key: slice) -> Cameras: ...
    def __getitem__(self, key: int | str | slice) -> Camera | Cameras:
        """A camera by position, or by name (with or without extension); a slice gives a collection.

        Raises:
            UnknownNameError: no camera has that name; the message lists the nearest.
            IndexError: the position is out of range.
        """
        if isinstance(key, slice):
            return Cameras(self._cameras[key])
        if not isinstance(key, str):
            return self._cameras[operator.index(key)]
        if key in self._by_name:
            return self._by_name[key]
        same_stem = [
            camera for camera in self._cameras if Path(camera.name).stem == key or camera.stem == key
        ]
        if len(same_stem) == 1:
            return same_stem[0]
        raise UnknownNameError("camera", key, self.names)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(camera.name for camera in self._cameras)

    def select(self, chosen: Callable[[Camera], bool] | Iterable[str | int]) -> Cameras:
        """The cameras for which ``chosen`` is true, or those named (or numbered) in it, in the order given."""
        if callable(chosen):
            return Cameras(camera for camera in self._cameras if chosen(camera))
        return Cameras(self[key] for key in chosen)

    def scaled(self, factor: float) -> Cameras:
        """All cameras with their image sizes multiplied by ``factor`` (rounded, at least one pixel)."""
        return Cameras(
            camera.resized(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))
            for camera in self._cameras
        )
