"""Projection of Gaussians and their expansion to tiles, in float64 as in ``raster.projection`` and ``raster.binning``.

There is little to compute for each Gaussian and each pair of a Gaussian and a tile, and what follows is done in
float32: with offsets taken from the tile's corner here, the pixels see small numbers however far a centre lies.
"""

# Triton's annotations are for its own compiler, which indexes tensors with None and does not unpack them.
# pyright: reportArgumentType=false, reportCallIssue=false, reportGeneralTypeIssues=false
# pyright: reportIndexIssue=false, reportOperatorIssue=false

from __future__ import annotations

import triton
import triton.language as tl

from scoup.raster.triton.kernels.blending import RECORD, ROW

# Places in the camera's float64 table, see ``triton.projection.camera_table``: 0 to 11 are the rows of the view matrix.
FX, FY, CX, CY = tl.constexpr(12), tl.constexpr(13), tl.constexpr(14), tl.constexpr(15)
LOW_X, HIGH_X, LOW_Y, HIGH_Y = tl.constexpr(16), tl.constexpr(17), tl.constexpr(18), tl.constexpr(19)
NEAR, WIDTH, HEIGHT = tl.constexpr(20), tl.constexpr(21), tl.constexpr(22)
LOW_PASS, ALPHA_MIN, LOG_ALPHA_MIN, SLACK = (
    tl.constexpr(23),
    tl.constexpr(24),
    tl.constexpr(25),
    tl.constexpr(26),
)
ROOT_LOG2_E, LOG2_E = tl.constexpr(27), tl.constexpr(28)
TABLE = 29

# Precomputed terms of a Gaussian's ellipse, so that a pair takes no division: few GPUs are fast in float64. For the
# exact test against a tile: its reach, and factors of offsets from the covariance ((xx, xy), (xy, yy)).
REACH = tl.constexpr(0)
SLOPE_Y, SLOPE_X = tl.constexpr(1), tl.constexpr(2)  # xy / xx, xy / yy
INVERSE_XX, INVERSE_YY = tl.constexpr(3), tl.constexpr(4)
WEIGHT_Y, WEIGHT_X = tl.constexpr(5), tl.constexpr(6)  # xx / determinant, yy / determinant
GEOMETRY = tl.constexpr(8)
# For the record, see ``blending.RECORD``: 32 bytes, which a GPU reads at once; the centre takes two places of each.
SHAPE = tl.constexpr(8)
KU, KV, SKEW, PEAK = tl.constexpr(4), tl.constexpr(5), tl.constexpr(6), tl.constexpr(7)


@triton.jit(do_not_specialize=["count"])
def sieve_kernel(
    means,  # [N, 3] float32
    scales,  # [N, 3] float32
    opacities,  # [N] float32
    camera,  # [TABLE] float64
    keep,  # [N] int8
    count,
    BLOCK: tl.constexpr,
):
    """Mark the Gaussians that may be visible, by their centre and largest scale alone. NaN fails every comparison; on a
    GPU the largest of scales may be a number though one of them is not: ``project_kernel`` leaves that Gaussian out.
    """
    row = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    there = row < count
    row = row.to(tl.int64)
    x, y, z = view_point(means, camera, row, there)
    largest = tl.abs(tl.load(scales + 3 * row, mask=there, other=0.0))
    largest = tl.maximum(largest, tl.abs(tl.load(scales + 3 * row + 1, mask=there, other=0.0)))
    largest = tl.maximum(largest, tl.abs(tl.load(scales + 3 * row + 2, mask=there, other=0.0))).to(tl.float64)
    opacity = tl.load(opacities + row, mask=there, other=0.0)

    # 3.34 standard deviations are the reach at opacity 1, and a ray may be clamped, which tilts the ellipse.
    ray_x = tl.maximum(-tl.load(camera + LOW_X), tl.load(camera + HIGH_X))
    ray_y = tl.maximum(-tl.load(camera + LOW_Y), tl.load(camera + HIGH_Y))
    fx, fy = tl.load(camera + FX), tl.load(camera + FY)
    reach_x = 3.375 * fx * tl.sqrt(1 + ray_x * ray_x) * largest + 2.0 * z
    reach_y = 3.375 * fy * tl.sqrt(1 + ray_y * ray_y) * largest + 2.0 * z
    left, top = tl.load(camera + CX), tl.load(camera + CY)
    right, bottom = tl.load(camera + WIDTH) - left, tl.load(camera + HEIGHT) - top
    seen = (fx * x + left * z + reach_x >= 0) & (fx * x - right * z - reach_x <= 0)
    seen &= (fy * y + top * z + reach_y >= 0) & (fy * y - bottom * z - reach_y <= 0)
    seen &= (z > tl.load(camera + NEAR)) & (opacity >= tl.load(camera + ALPHA_MIN).to(tl.float32))
    tl.store(keep + row, seen.to(tl.int8), mask=there)


@triton.jit(do_not_specialize=["n_visible", "across", "down"])
def project_kernel(
    ids,  # [M] int64: rows of the scene
    means,  # [N, 3] float32
    quats,  # [N, 4] float32
    scales,  # [N, 3] float32
    opacities,  # [N] float32
    camera,  # [TABLE] float64
    depths,  # [M] float64
    geometry,  # [M, GEOMETRY] float64
    shapes,  # [M, SHAPE] float32: the centre as two float64, then ku, kv, skew, peak
    centres,  # the same memory as float64
    rects,  # [M, 3] int32: first column and row of tiles, columns
    counts,  # [M] int32: tiles in the rectangle around the ellipse
    n_visible,
    across,
    down,
    TILE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    slot = tl.program_id(0) * BLOCK + tl.arange(0, BLOCK)
    there = slot < n_visible
    row = tl.load(ids + slot, mask=there, other=0)
    x, y, z = view_point(means, camera, row, there)
    z = tl.where(there, z, 1.0)

    w = tl.load(quats + 4 * row, mask=there, other=1.0).to(tl.float64)
    i = tl.load(quats + 4 * row + 1, mask=there, other=0.0).to(tl.float64)
    j = tl.load(quats + 4 * row + 2, mask=there, other=0.0).to(tl.float64)
    k = tl.load(quats + 4 * row + 3, mask=there, other=0.0).to(tl.float64)
    scale_0 = tl.load(scales + 3 * row, mask=there, other=0.0).to(tl.float64)
    scale_1 = tl.load(scales + 3 * row + 1, mask=there, other=0.0).to(tl.float64)
    scale_2 = tl.load(scales + 3 * row + 2, mask=there, other=0.0).to(tl.float64)
    poison = (w + i + j + k + scale_0 + scale_1 + scale_2 + x + y + z) * 0
    length = tl.sqrt(w * w + i * i + j * j + k * k)
    alive = there & (poison == 0) & (length > 0)
    length = tl.where(alive, length, 1.0)
    w, i, j, k = w / length, i / length, j / length, k / length

    fx, fy = tl.load(camera + FX), tl.load(camera + FY)
    ray_x = tl.minimum(tl.maximum(x / z, tl.load(camera + LOW_X)), tl.load(camera + HIGH_X))
    ray_y = tl.minimum(tl.maximum(y / z, tl.load(camera + LOW_Y)), tl.load(camera + HIGH_Y))
    # B = J W R S [2, 3], column by column; B B^T is the 2D covariance before the low-pass.
    x0, y0 = factor_column(
        camera, 1 - 2 * (j * j + k * k), 2 * (i * j + w * k), 2 * (i * k - w * j), scale_0, ray_x, ray_y, z
    )
    x1, y1 = factor_column(
        camera, 2 * (i * j - w * k), 1 - 2 * (i * i + k * k), 2 * (j * k + w * i), scale_1, ray_x, ray_y, z
    )
    x2, y2 = factor_column(
        camera, 2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * (i * i + j * j), scale_2, ray_x, ray_y, z
    )
    low_pass = tl.load(camera + LOW_PASS)
    square_x, square_y = x0 * x0 + x1 * x1 + x2 * x2, y0 * y0 + y1 * y1 + y2 * y2
    xx, yy, xy = square_x + low_pass, square_y + low_pass, x0 * y0 + x1 * y1 + x2 * y2
    # det(B B^T + c I) by its minors: a difference xx yy - xy^2 would lose every digit of a needle.
    minor_0, minor_1, minor_2 = x1 * y2 - x2 * y1, x2 * y0 - x0 * y2, x0 * y1 - x1 * y0
    determinant = minor_0 * minor_0 + minor_1 * minor_1 + minor_2 * minor_2
    determinant += low_pass * (square_x + square_y) + low_pass * low_pass
    centre_x = x / z * fx + tl.load(camera + CX)
    centre_y = y / z * fy + tl.load(camera + CY)

    opacity = tl.load(opacities + row, mask=there, other=1.0).to(tl.float64)
    opacity = tl.minimum(opacity, 1.0)
    log_opacity = tl.log(tl.maximum(opacity, tl.load(camera + ALPHA_MIN)))
    reach = tl.maximum(2 * (log_opacity - tl.load(camera + LOG_ALPHA_MIN)), 0.0)
    # Gaussians whose squared scales overflow are not drawn.
    alive &= (determinant * 0 == 0) & (xx * 0 == 0) & (yy * 0 == 0)

    extent_x, extent_y = tl.sqrt(reach * xx), tl.sqrt(reach * yy)
    width, height = tl.load(camera + WIDTH), tl.load(camera + HEIGHT)
    alive &= (centre_x + extent_x >= 0.5) & (centre_x - extent_x <= width - 0.5)
    alive &= (centre_y + extent_y >= 0.5) & (centre_y - extent_y <= height - 0.5)
    slack = tl.load(camera + SLACK)
    first_x, span_x = tile_span(centre_x, extent_x + slack, across, alive, TILE)
    first_y, span_y = tile_span(centre_y, extent_y + slack, down, alive, TILE)

    tl.store(depths + slot, z, mask=there)
    tl.store(counts + slot, tl.where(alive, span_x * span_y, 0), mask=there)
    tl.store(rects + 3 * slot, first_x, mask=there)
    tl.store(rects + 3 * slot + 1, first_y, mask=there)
    tl.store(rects + 3 * slot + 2, tl.maximum(span_x, 1), mask=there)
    geometry_row = geometry + GEOMETRY * slot.to(tl.int64)
    tl.store(geometry_row + REACH, reach, mask=there)
    inverse_xx, inverse_yy, inverse = 1.0 / xx, 1.0 / yy, 1.0 / determinant
    tl.store(geometry_row + SLOPE_Y, xy * inverse_xx, mask=there)
    tl.store(geometry_row + SLOPE_X, xy * inverse_yy, mask=there)
    tl.store(geometry_row + INVERSE_XX, inverse_xx, mask=there)
    tl.store(geometry_row + INVERSE_YY, inverse_yy, mask=there)
    tl.store(geometry_row + WEIGHT_Y, xx * inverse, mask=there)
    tl.store(geometry_row + WEIGHT_X, yy * inverse, mask=there)
    root = tl.load(camera + ROOT_LOG2_E)
    ku = root * tl.sqrt(0.5 * yy * inverse)
    shape = shapes + SHAPE * slot.to(tl.int64)
    tl.store(shape + KU, ku.to(tl.float32), mask=there)
    tl.store(shape + KV, (root * tl.sqrt(0.5 * inverse_yy)).to(tl.float32), mask=there)
    tl.store(shape + SKEW, (ku * (xy * inverse_yy)).to(tl.float32), mask=there)
    tl.store(shape + PEAK, (log_opacity * tl.load(camera + LOG2_E)).to(tl.float32), mask=there)
    centre = centres + SHAPE // 2 * slot.to(tl.int64)
    tl.store(centre, centre_x, mask=there)
    tl.store(centre + 1, centre_y, mask=there)


@triton.jit(do_not_specialize=["n_candidates", "across", "down"])
def expand_kernel(
    ranks,  # [C] int64: place of the candidate's Gaussian by depth
    order,  # [M] int64: slots by depth
    firsts,  # [M + 1] int64: first candidate of each place
    rects,  # [M, 3] int32
    geometry,  # [M, GEOMETRY] float64
    centres,  # [M, SHAPE / 2] float64
    camera,  # [TABLE] float64
    tiles,  # [C] int16 or int32: out; across * down where the ellipse misses the tile
    slots,  # [C] int32: out
    n_candidates,
    across,
    down,
    TILE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    candidate = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = candidate < n_candidates
    rank = tl.load(ranks + candidate, mask=there, other=0)
    slot = tl.load(order + rank, mask=there, other=0)
    within = (candidate - tl.load(firsts + rank, mask=there, other=0)).to(tl.int32)
    span = tl.load(rects + 3 * slot + 2, mask=there, other=1)
    row = within // span
    column = within - row * span + tl.load(rects + 3 * slot, mask=there, other=0)
    row += tl.load(rects + 3 * slot + 1, mask=there, other=0)
    touched = ellipse_touches(
        geometry + GEOMETRY * slot, centres + SHAPE // 2 * slot, column, row, there, camera, TILE
    )
    tl.store(slots + candidate, slot.to(tl.int32), mask=there)
    tile = tl.where(touched, row * across + column, across * down)
    tl.store(tiles + candidate, tile.to(tiles.dtype.element_ty), mask=there)


@triton.jit(do_not_specialize=["n_candidates", "n_records", "across", "down"])
def list_kernel(
    by_tile,  # [C] int64: candidates, tile after tile
    tiles,  # [C] int16 or int32: their tiles, in this order
    slots,  # [C] int32
    ids,  # [M] int64
    shapes,  # [M, SHAPE] float32
    centres,  # the same memory as float64
    records,  # [., RECORD] float32: out
    n_candidates,
    n_records,
    across,
    down,
    TILE: tl.constexpr,
    BLOCK: tl.constexpr,
):
    pair = tl.program_id(0).to(tl.int64) * BLOCK + tl.arange(0, BLOCK)
    there = pair < n_candidates
    candidate = tl.load(by_tile + pair, mask=there, other=0)
    tile = tl.load(tiles + pair, mask=there, other=0).to(tl.int32)
    listed = there & (tile < across * down)
    slot = tl.load(slots + candidate, mask=listed, other=0).to(tl.int64)
    corner_x, corner_y = corner_at(centres + SHAPE // 2 * slot, tile % across, tile // across, listed, TILE)
    shape = shapes + SHAPE * slot
    ku = tl.load(shape + KU, mask=listed, other=0.0)
    kv = tl.load(shape + KV, mask=listed, other=0.0)
    skew = tl.load(shape + SKEW, mask=listed, other=0.0)
    peak = tl.load(shape + PEAK, mask=listed, other=0.0)
    u = tl.where(listed, ku.to(tl.float64) * corner_x - skew.to(tl.float64) * corner_y, 0.0).to(tl.float32)
    v = tl.where(listed, kv.to(tl.float64) * corner_y, 0.0).to(tl.float32)
    gaussian = tl.load(ids + slot, mask=listed, other=0).to(tl.int32).to(tl.float32, bitcast=True)
    # Write whole records together: one thread per record would use an eighth of the memory width.
    index = tl.arange(0, RECORD)[None, :]
    record = tl.where(index == 0, u[:, None], tl.where(index == 1, v[:, None], 0.0))
    record = tl.where(index == 2, ku[:, None], tl.where(index == 3, kv[:, None], record))
    record = tl.where(index == 4, skew[:, None], tl.where(index == 5, peak[:, None], record))
    record = tl.where(index == ROW, gaussian[:, None], record)
    tl.store(records + pair[:, None] * RECORD + index, record, mask=(pair < n_records)[:, None])


@triton.jit
def corner_at(centre, column, row, there, TILE: tl.constexpr):
    """The first pixel of a tile, from the ellipse's centre."""
    corner_x = (column * TILE).to(tl.float64) + 0.5 - tl.load(centre, mask=there, other=0.0)
    corner_y = (row * TILE).to(tl.float64) + 0.5 - tl.load(centre + 1, mask=there, other=0.0)
    return corner_x, corner_y


@triton.jit
def ellipse_touches(ellipse, centre, column, row, there, camera, TILE: tl.constexpr):
    """Does the ellipse alpha >= 1/255 reach the rectangle of the tile's pixel centres? See ``raster.binning``."""
    corner_x, corner_y = corner_at(centre, column, row, there, TILE)
    slack = tl.load(camera + SLACK)
    x0, y0 = corner_x - slack, corner_y - slack
    x1, y1 = x0 + (TILE - 1) + 2 * slack, y0 + (TILE - 1) + 2 * slack
    edge_x = tl.maximum(x0, 0.0) + tl.minimum(x1, 0.0)
    edge_y = tl.maximum(y0, 0.0) + tl.minimum(y1, 0.0)
    off_y = tl.load(ellipse + SLOPE_Y, mask=there, other=0.0) * edge_x
    off_y -= tl.minimum(tl.maximum(off_y, y0), y1)
    off_x = tl.load(ellipse + SLOPE_X, mask=there, other=0.0) * edge_y
    off_x -= tl.minimum(tl.maximum(off_x, x0), x1)
    weight_y = tl.load(ellipse + WEIGHT_Y, mask=there, other=0.0)
    weight_x = tl.load(ellipse + WEIGHT_X, mask=there, other=0.0)
    by_x = edge_x * edge_x * tl.load(ellipse + INVERSE_XX, mask=there, other=0.0) + off_y * off_y * weight_y
    by_y = edge_y * edge_y * tl.load(ellipse + INVERSE_YY, mask=there, other=0.0) + off_x * off_x * weight_x
    best = tl.where(edge_x == 0, by_y, tl.where(edge_y == 0, by_x, tl.minimum(by_x, by_y)))
    reach = tl.load(ellipse + REACH, mask=there, other=-1.0)
    return ((edge_x == 0) & (edge_y == 0)) | (best <= reach)


@triton.jit
def view_point(means, camera, row, there):
    """The means in the camera's frame, float64."""
    x = tl.load(means + 3 * row, mask=there, other=0.0).to(tl.float64)
    y = tl.load(means + 3 * row + 1, mask=there, other=0.0).to(tl.float64)
    z = tl.load(means + 3 * row + 2, mask=there, other=0.0).to(tl.float64)
    return turned(camera, 0, x, y, z), turned(camera, 4, x, y, z), turned(camera, 8, x, y, z)


@triton.jit
def turned(camera, row, x, y, z):
    """One coordinate of points in the camera's frame; ``row`` is where the matrix row begins in the table."""
    base = camera + row
    return tl.load(base) * x + tl.load(base + 1) * y + tl.load(base + 2) * z + tl.load(base + 3)


@triton.jit
def factor_column(camera, x, y, z, scale, ray_x, ray_y, depth):
    """One column of B: the axis (x, y, z) of the rotation in the image plane, times its scale."""
    axis_x = tl.load(camera) * x + tl.load(camera + 1) * y + tl.load(camera + 2) * z
    axis_y = tl.load(camera + 4) * x + tl.load(camera + 5) * y + tl.load(camera + 6) * z
    axis_z = tl.load(camera + 8) * x + tl.load(camera + 9) * y + tl.load(camera + 10) * z
    along_x = (axis_x - ray_x * axis_z) * scale * (tl.load(camera + FX) / depth)
    along_y = (axis_y - ray_y * axis_z) * scale * (tl.load(camera + FY) / depth)
    return along_x, along_y


@triton.jit
def tile_span(centre, extent, tiles, alive, TILE: tl.constexpr):
    """First tile and number of tiles along one axis. Clamped as floats: an ellipse may be wider than any integer."""
    low = tl.floor(tl.ceil(centre - extent - 0.5) / TILE)
    high = tl.floor(tl.floor(centre + extent - 0.5) / TILE)
    limit = tl.zeros_like(low) + tiles
    low = tl.minimum(tl.maximum(tl.where(alive, low, 0.0), 0.0), limit)
    high = tl.minimum(tl.maximum(tl.where(alive, high, -1.0), -1.0), limit - 1)
    first = low.to(tl.int32)
    return first, tl.maximum(high.to(tl.int32) - first + 1, 0)
