"""The frame of a scene in the world: the length of its unit, its up direction, its name, and its place on Earth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from torch import Tensor

from scoup.base import InputError, rounded_vector
from scoup.scene.directions import checked_direction

Vector = tuple[float, float, float]
_ROUNDING = 1e-9  # of a unit vector, which is kept to the last bit


@dataclass(frozen=True)
class WorldFrame:
    """The relation of a scene's coordinates to the world; what is None is not known.

    Raises:
        InputError: a length is not above 0, a direction is zero, or the origin is not on Earth.

    Example:
        >>> scoup.WorldFrame(metres_per_unit=0.5).lengths([0.3, 0.2])
        '0.15 x 0.1 m'
    """

    metres_per_unit: float | None = None
    """Length of the scene's unit in metres."""
    up: Vector | None = None
    """Unit vector in the axes of the scene; None: estimated from the cameras."""
    north: Vector | None = None
    """Unit vector in the axes of the scene."""
    origin: Vector | None = None
    """Latitude and longitude (degrees) and height above the ellipsoid (metres) of the point 0, 0, 0, in WGS 84."""
    name: str = ""
    """Name of the frame, such as the ``frame_id`` of ROS."""

    def __post_init__(self) -> None:
        if self.metres_per_unit is not None:
            check_metres(self.metres_per_unit, "metres per unit")
        for name in ("up", "north"):
            if (direction := getattr(self, name)) is not None:
                unit = checked_direction(direction, name).tolist()
                exact = math.dist(unit, direction) < _ROUNDING
                object.__setattr__(self, name, tuple(map(float, direction)) if exact else tuple(unit))
        if self.up and self.north and abs(sum(map(float.__mul__, self.up, self.north))) > 0.99:
            raise InputError(f"north {list(self.north)} is up or down; pass a horizontal direction")
        if self.origin is not None:
            latitude, longitude, height = map(float, self.origin)
            if not (abs(latitude) <= 90 and abs(longitude) <= 180 and math.isfinite(height)):
                raise InputError(
                    f"origin: expected latitude (-90 to 90), longitude (-180 to 180), height; got {list(self.origin)}"
                )
            object.__setattr__(self, "origin", (latitude, longitude, height))

    @classmethod
    def of_dict(cls, record: Mapping[str, Any]) -> WorldFrame:
        """Return the frame of ``to_dict``; unknown keys are ignored."""
        values = {name: record[name] for name in asdict(cls()) if record.get(name) is not None}
        return cls(
            **{name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        )

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {
            name: list(value) if isinstance(value, tuple) else value for name, value in asdict(self).items()
        }

    def lengths(self, values: Sequence[float]) -> str:
        """Return lengths of the scene in words: in metres, or in scene units while a metre is not known."""
        scale, unit = (1.0, "scene units") if self.metres_per_unit is None else (self.metres_per_unit, "m")
        return f"{' x '.join(f'{scale * value:.3g}' for value in values)} {unit}"

    def place(self, position: Tensor, extent: Tensor) -> str:
        """Return a position [3] and an extent [3] in words, both in the unit of ``lengths``."""
        scaled = position * (self.metres_per_unit or 1.0)
        at = ", ".join(f"{value:g}" for value in rounded_vector(scaled.tolist()))
        return f"[{at}], extent {self.lengths(extent.tolist())}"

    def metres(self, position: Tensor, extent: Tensor) -> dict[str, list[float]]:
        """Return a position [3] and an extent [3] in metres as JSON values; nothing while a metre is not known."""
        if self.metres_per_unit is None:
            return {}
        named = {"position_metres": position, "extent_metres": extent}
        return {
            name: rounded_vector((value * self.metres_per_unit).tolist()) for name, value in named.items()
        }


def check_metres(length: float, what: str) -> None:
    """Refuse a length that is not a number above 0.

    Raises:
        InputError: it is not; ``what`` names it.
    """
    if not 0 < length < math.inf:
        raise InputError(f"{what} must be above 0, got {length}")
