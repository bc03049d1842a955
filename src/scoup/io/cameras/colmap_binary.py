"""The binary files of a COLMAP model. Every count is checked against the size of the file."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, existing_file
from scoup.io.cameras.colmap_model import MODEL_NAMES, PARAMETER_COUNTS, Lens, Points, Shot
from scoup.io.reading import decoded, read_bytes

_REMEDY = "the file is cut short or damaged; copy or export it again"
_LENS = struct.Struct("<iiQQ")
_SHOT = struct.Struct("<I4d3dI")
_POINT = struct.Struct("<Q3d3BdQ")
_SEEN_BYTES = 24  # x, y and point number of one keypoint
_TRACK_BYTES = 8
_MAX_NAME = 4096


class _Cursor:
    """Reads records one after another and refuses to run past the end."""

    def __init__(self, path: Path) -> None:
        self.path = existing_file(path, "a file of a COLMAP model")
        self.data = read_bytes(path)
        self.position = 0

    def take(self, record: struct.Struct) -> tuple:
        start = self.position
        self.skip(record.size)
        return record.unpack_from(self.data, start)

    def skip(self, size: int) -> None:
        if size > len(self.data) - self.position:
            raise FileFormatError(
                self.path, f"ends in the middle of a record (byte {self.position})", _REMEDY
            )
        self.position += size

    def count(self, smallest: int, what: str) -> int:
        """Return a number of records, each of at least ``smallest`` bytes."""
        (count,) = self.take(struct.Struct("<Q"))
        if count * smallest > len(self.data) - self.position:
            raise FileFormatError(self.path, f"claims {count} {what}, more than fit into the file", _REMEDY)
        return count

    def name(self) -> str:
        end = self.data.find(b"\0", self.position, self.position + _MAX_NAME)
        if end < 0:
            raise FileFormatError(self.path, "has an unterminated image name", _REMEDY)
        raw = self.data[self.position : end]
        self.position = end + 1
        if not raw:
            raise FileFormatError(self.path, "has an image without a name", _REMEDY)
        return decoded(self.path, raw)


def read_lenses(path: Path) -> dict[int, Lens]:
    """Read cameras.bin: lenses by number."""
    cursor = _Cursor(path)
    lenses = {}
    for _ in range(cursor.count(_LENS.size, "cameras")):
        identifier, model, width, height = cursor.take(_LENS)
        if not 0 <= model < len(MODEL_NAMES):
            problem = f"has a camera of model {model}, which is not known"
            remedy = (
                "make pinhole images with colmap image_undistorter, or copy the file again if it is damaged"
            )
            raise FileFormatError(path, problem, remedy)
        name = MODEL_NAMES[model]
        parameters = cursor.take(struct.Struct(f"<{PARAMETER_COUNTS[name]}d"))
        lenses[identifier] = Lens(name, width, height, parameters)
    return lenses


def read_shots(path: Path) -> list[Shot]:
    """Read images.bin, keypoints skipped."""
    cursor = _Cursor(path)
    shots = []
    for _ in range(cursor.count(_SHOT.size + 9, "images")):
        values = cursor.take(_SHOT)
        name = cursor.name()
        cursor.skip(_SEEN_BYTES * cursor.count(_SEEN_BYTES, "keypoints"))
        lens = int(np.int32(np.uint32(values[8])))
        shots.append(Shot(values[0], name, lens, values[1:5], values[5:8]))
    return shots


def read_points(path: Path) -> Points:
    """Read points3D.bin."""
    cursor = _Cursor(path)
    count = cursor.count(_POINT.size, "points")
    positions, colors = np.empty((count, 3)), np.empty((count, 3), dtype=np.uint8)
    lengths, tracks = np.empty(count, np.int64), bytearray()
    for row in range(count):
        values = cursor.take(_POINT)
        positions[row], colors[row] = values[1:4], values[4:7]
        start = cursor.position
        cursor.skip(_TRACK_BYTES * values[8])
        lengths[row] = values[8]
        tracks += cursor.data[start : cursor.position]
    return Points(positions, colors, lengths, np.frombuffer(tracks, "<u4")[::2])
