"""A small z-buffer for triangle meshes: which triangle is in front at each pixel. It does not know Gaussians.

The truth of synthetic scenes comes from here, so that it is independent of the rasteriser.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scoup.scene import Camera
from scoup_lab.synthetic.art.meshes import Floats, Ints

NEAR = 0.05
CHUNK = 2_000_000  # candidate pixels held at once


def visible_faces(vertices: Floats, faces: Ints, camera: Camera) -> NDArray[np.int64]:
    """Return the triangle seen at each pixel centre.

    ``vertices``: [V, 3] world coordinates; ``faces``: [F, 3] rows of ``vertices``. Returns [H, W] int64 rows
    of ``faces``; -1 where nothing is seen. Triangles seen from behind, and those with a corner nearer than
    ``NEAR``, are left out; at equal depth the higher row is taken.
    """
    viewmat, intrinsics = camera.viewmat.numpy(), camera.K.numpy()
    points = vertices @ viewmat[:3, :3].T + viewmat[:3, 3]
    in_front = points[:, 2] > NEAR
    depth = np.where(in_front, points[:, 2], 1.0)
    # The inverse depth is linear over a triangle in the image, the depth is not.
    pixels = (points[:, :2] @ intrinsics[:2, :2].T) / depth[:, None] + intrinsics[:2, 2]
    front = np.flatnonzero(in_front[faces].all(1))
    # Image rows run downwards, so a face that turns anticlockwise seen from outside turns clockwise here.
    nearest, _ = draw(pixels, 1.0 / depth, faces[front][:, ::-1], camera.width, camera.height)
    return np.append(front, -1)[nearest]


def draw(
    pixels: Floats, nearness: Floats, faces: Ints, width: int, height: int
) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
    """Draw triangles into a z-buffer.

    ``pixels``: [V, 2] image coordinates of the vertices; pixel centres lie at +0.5; ``nearness``: [V]
    positive, linear over each triangle in the image, larger is in front; ``faces``: [F, 3] rows of the
    vertices; those that turn from the second axis to the first are not drawn. Returns [H, W] int64 number of
    the triangle in front (-1: none), and its nearness [H, W] float32 (0: none).
    """
    a, b, c = (pixels[faces[:, corner]] for corner in range(3))
    area = (b[:, 0] - a[:, 0]) * (c[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (c[:, 0] - a[:, 0])
    low, high = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    first = np.ceil(low - 0.5).clip(0)
    last = np.floor(high - 0.5).clip(-1, (width - 1, height - 1))
    drawn = np.flatnonzero((area > 0) & (first <= last).all(1))
    a, b, c, area, near = a[drawn], b[drawn], c[drawn], area[drawn], nearness[faces[drawn]]
    # Over a triangle, the share of each corner and so the nearness is affine: slope_x * x + slope_y * y + level.
    shares = np.stack([_share(b, c, area), _share(c, a, area), _share(a, b, area)])  # [3 corners, F, 3 terms]
    plane = np.einsum("cft,fc->ft", shares, near)

    rows = (last - first)[drawn, 1].astype(np.int64) + 1
    buffer = np.full(width * height, -1, np.int64)
    for chunk in np.array_split(np.arange(len(drawn)), 1 + int(rows.sum()) * 8 // CHUNK):
        face, row = _repeated(chunk, rows[chunk], first[drawn[chunk], 1].astype(np.int64))
        start, end = _span(shares[:, face], np.asarray(row + 0.5, np.float64), width)
        filled = start <= end
        face, row, start, end = face[filled], row[filled], start[filled], end[filled]
        line, x = _repeated(np.arange(len(face)), end - start + 1, start)
        slope_x, rest = plane[face, 0], plane[face, 1] * (row + 0.5) + plane[face, 2]
        value = (slope_x[line] * (x + 0.5) + rest[line]).astype(np.float32)
        # The bits of a positive float grow with its value, so one integer maximum decides depth and face together.
        key = value.view(np.int32).astype(np.int64) << 32 | drawn[face][line]
        np.maximum.at(buffer, (row * width)[line] + x, key)
    seen = buffer >= 0
    number = np.where(seen, buffer & 0xFFFFFFFF, -1)
    depth = np.where(seen, buffer >> 32, 0).astype(np.int32).view(np.float32)
    return number.reshape(height, width), depth.reshape(height, width)


def _share(start: Floats, end: Floats, area: Floats) -> Floats:
    """Return [F, 3] slopes and level of the share that is 0 on the edge start-end and 1 on the corner across."""
    slope_x, slope_y = (start[:, 1] - end[:, 1]) / area, (end[:, 0] - start[:, 0]) / area
    return np.stack([slope_x, slope_y, -(slope_x * start[:, 0] + slope_y * start[:, 1])], 1)


def _span(shares: Floats, y: Floats, width: int) -> tuple[Ints, Ints]:
    """Return first and last pixel of each triangle on a row: where all three shares [3, n, 3] are not negative."""
    start, end = np.zeros(len(y)), np.full(len(y), width - 1.0)
    for share in shares:
        slope, rest = share[:, 0], share[:, 1] * y + share[:, 2] + 1e-9
        crossing = -rest / np.where(slope == 0, 1, slope) - 0.5
        start = np.where(slope > 0, np.maximum(start, np.ceil(crossing)), start)
        end = np.where(slope < 0, np.minimum(end, np.floor(crossing)), end)
        end = np.where((slope == 0) & (rest < 0), -1, end)
    return start.astype(np.int64), end.astype(np.int64)


def _repeated(items: Ints, counts: Ints, first: Ints) -> tuple[Ints, Ints]:
    """Return each item ``counts`` times, and beside it the numbers ``first``, ``first + 1``, ..."""
    step = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts - first, counts)
    return np.repeat(items, counts), step
