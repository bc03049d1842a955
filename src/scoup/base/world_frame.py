"""The frame of a scene in the world: the length of its unit, its up direction, its name, and its place on Earth."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from scoup.base.errors import InputError
from scoup.base.texts import rounded_vector

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
        if not isinstance(self.name, str):
            raise InputError(f"name: expected a text, got {self.name!r:.50}")
        if self.metres_per_unit is not None:
            check_metres(self.metres_per_unit, "metres per unit")
        for name in ("up", "north"):
            if (direction := getattr(self, name)) is not None:
                object.__setattr__(self, name, _unit_vector(name, *direction))
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
    def of_header(cls, header: Mapping[str, Any]) -> WorldFrame:
        """Return the frame that the header of a file has (``entry``), or one of which nothing is known; unknown keys
        are ignored.

        Raises:
            InputError: a value is not what it should be.
        """
        record = header.get("frame", {})
        values = {name: record[name] for name in asdict(cls()) if record.get(name) is not None}
        try:
            return cls(**values)
        except InputError as error:
            raise InputError(f"frame: {error}") from error
        except (TypeError, ValueError, OverflowError):
            raise InputError("frame: has values of other types than a frame of the world") from None

    def entry(self) -> dict[str, Any]:
        """Return its entry in the header of a file; nothing for a frame of which nothing is known."""
        return {} if self == WorldFrame() else {"frame": self.to_dict()}

    def to_dict(self) -> dict[str, Any]:
        """Return it as plain JSON values."""
        return {name: list(value) if type(value) is tuple else value for name, value in asdict(self).items()}

    def lengths(self, values: Iterable[float]) -> str:
        """Return lengths of the scene in words: in metres, or in scene units while a metre is not known."""
        scale, unit = (1.0, "scene units") if self.metres_per_unit is None else (self.metres_per_unit, "m")
        return f"{' x '.join(f'{scale * value:.3g}' for value in values)} {unit}"

    def place(self, position: Iterable[float], extent: Iterable[float]) -> str:
        """Return a position and an extent in words, both in the unit of ``lengths``."""
        unit = self.metres_per_unit or 1.0
        at = ", ".join(f"{value:g}" for value in rounded_vector([unit * value for value in position]))
        return f"[{at}], extent {self.lengths(extent)}"

    def metres(self, position: Iterable[float], extent: Iterable[float]) -> dict[str, list[float]]:
        """Return a position and an extent in metres as JSON values; nothing while a metre is not known."""
        if (unit := self.metres_per_unit) is None:
            return {}
        named = {"position_metres": position, "extent_metres": extent}
        return {name: rounded_vector([unit * value for value in values]) for name, values in named.items()}


def _unit_vector(name: str, *direction: float) -> Vector:
    length = math.hypot(*direction)
    if len(direction) != 3 or not 0 < length < math.inf:
        raise InputError(f"{name}: expected three numbers that are not all 0, got {[*direction]}")
    if abs(length - 1) > _ROUNDING:
        direction = tuple(value / length for value in direction)
    x, y, z = map(float, direction)
    return x, y, z


def check_metres(length: float, what: str) -> None:
    """Refuse a length that is not a number above 0; ``what`` names it."""
    if not 0 < length < math.inf:
        raise InputError(f"{what} must be above 0, got {length}")
