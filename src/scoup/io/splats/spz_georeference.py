"""The extension SPZ_NIANTIC_georeference of .spz files: a similarity from the scene to the coordinates of the Earth.

As in the draft of September 2026 (github.com/nianticlabs/spz, pull request 105). Its axes are right, up, back; those of
WGS 84 have their origin in the middle of the Earth (EPSG:4978).
"""

from __future__ import annotations

import math
import struct

import numpy as np

from scoup.base import InputError, WorldFrame

GEOREFERENCE = 0x4E530001  # the type of its records
# Version, flags, bytes of the name behind it, origin, rotation, scale, epoch.
_RECORD = struct.Struct("<BBH3d4ddd")
_CODE = b"EPSG:4978"
_RADIUS, _SQUARE = 6_378_137.0, 6.694379990141e-3  # of the equator in metres, and eccentricity of WGS 84
_FARTHEST = 1e6  # metres above or below the ellipsoid


def read_georeference(record: bytes) -> WorldFrame | None:
    """Return the frame of a record; None if it is of another version, body or draft."""
    if len(record) != _RECORD.size + len(_CODE) or not record.endswith(_CODE):
        return None
    version, flags, length, *numbers = _RECORD.unpack_from(record)
    origin, quaternion, scale = np.array(numbers[:3]), np.array(numbers[3:7]), numbers[7]
    is_unit = abs(float(np.linalg.norm(quaternion)) - 1) <= 1e-6
    if version != 1 or flags & 0b110 or length != len(_CODE) or not is_unit:
        return None
    from scipy.spatial.transform import Rotation

    latitude, longitude, height = _geodetic(*origin.tolist())
    _, north, up = Rotation.from_quat(quaternion).inv().apply(_east_north_up(latitude, longitude)).tolist()
    try:
        if not abs(height) <= _FARTHEST:
            return None
        place = math.degrees(latitude), math.degrees(longitude), height
        return WorldFrame(scale, tuple(up), tuple(north), place)
    except InputError:
        return None


def georeference_record(world: WorldFrame) -> bytes:
    """Return the record of a frame; nothing if it lacks the length of the unit, up, north or the origin."""
    if not (world.metres_per_unit and world.up and world.north and world.origin):
        return b""
    from scipy.spatial.transform import Rotation

    latitude, longitude = map(math.radians, world.origin[:2])
    up, north = np.array(world.up), np.array(world.north)
    east = np.cross(north, up)
    east /= np.linalg.norm(east)
    local = np.stack([east, np.cross(up, east), up])
    quaternion = Rotation.from_matrix(_east_north_up(latitude, longitude).T @ local).as_quat()
    origin = _geocentric(latitude, longitude, world.origin[2])
    numbers = *origin, *quaternion.tolist(), world.metres_per_unit, math.nan
    return _RECORD.pack(1, 0, len(_CODE), *numbers) + _CODE


def _east_north_up(latitude: float, longitude: float) -> np.ndarray:
    """Return the unit vectors [3, 3] of a place, in radians; one per row."""
    (s, c), (t, d) = ((math.sin(angle), math.cos(angle)) for angle in (latitude, longitude))
    return np.array([[-t, d, 0.0], [-s * d, -s * t, c], [c * d, c * t, s]])


def _geocentric(latitude: float, longitude: float, height: float) -> tuple[float, float, float]:
    sine, cosine = math.sin(latitude), math.cos(latitude)
    normal = _RADIUS / math.sqrt(1 - _SQUARE * sine**2)
    across = (normal + height) * cosine
    return (
        across * math.cos(longitude),
        across * math.sin(longitude),
        (normal * (1 - _SQUARE) + height) * sine,
    )


def _geodetic(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return latitude and longitude in radians, and height."""
    across = math.hypot(x, y)
    latitude = math.atan2(z, across * (1 - _SQUARE))
    for _ in range(6):  # each step is more exact by a factor of 150 or more
        normal = _RADIUS / math.sqrt(1 - _SQUARE * math.sin(latitude) ** 2)
        latitude = math.atan2(z + _SQUARE * normal * math.sin(latitude), across)
    sine, cosine = math.sin(latitude), math.cos(latitude)
    height = across * cosine + z * sine - _RADIUS * math.sqrt(1 - _SQUARE * sine**2)
    return latitude, math.atan2(y, x), height
