"""Counting lanes: against literal loops over pixels and Gaussians; and instructions a pixel made of them."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.gpu import a_pixel, instructions, lanes
from benchmarks.gpu.launches import launches
from benchmarks.gpu.tile_walks import GSPLAT, Walk, chunked, rectangles, walk

from scoup.base.errors import FileFormatError, InputError, MissingFileError, OutputExistsError
from scoup.bench import count_evaluations
from scoup.raster.binning import bin_to_tiles
from scoup.raster.presets import RASTER_PRESETS, RasterPreset
from scoup.raster.projection import ProjectedGaussians, project_gaussians
from support import make_camera, random_gaussians

ALL = 10**6
SIZES = [(40, 27), (16, 16), (70, 50), (5, 3)]


def alpha_at(projection: ProjectedGaussians, rank: int, x: float, y: float, preset: RasterPreset) -> float:
    xx, xy, yy = projection.covariances[rank].tolist()
    centre_x, centre_y = projection.means2d[rank].tolist()
    dx, dy = x - centre_x, y - centre_y
    distance = (yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / projection.determinants[rank].item()
    return min(projection.opacities[rank].item() * math.exp(-distance / 2), preset.alpha_max)


def literal_tile(
    projection: ProjectedGaussians,
    ranks: list[int],
    left: int,
    top: int,
    tile: int,
    size: tuple[int, int],
    preset: RasterPreset,
) -> dict[tuple[int, int], list[bool]]:
    """For each pixel (x, y) inside the image whether each Gaussian paints it, as far as it looks at them."""
    found: dict[tuple[int, int], list[bool]] = {}
    for y in range(top, min(top + tile, size[1])):
        for x in range(left, min(left + tile, size[0])):
            transmittance, paints = 1.0, []
            for rank in ranks:
                alpha = alpha_at(projection, rank, x + 0.5, y + 0.5, preset)
                if alpha < 1 / 255:
                    paints.append(False)
                    continue
                after = transmittance * (1 - alpha)
                if after < preset.stop or (preset.stop_inclusive and after == preset.stop):
                    paints.append(False)
                    break
                transmittance = after
                paints.append(True)
            found[x, y] = paints
    return found


def literal_lists(projection: ProjectedGaussians, size: tuple[int, int]) -> dict[tuple[int, int], list[int]]:
    """gsplat's: by column and row of the tile."""
    found: dict[tuple[int, int], list[int]] = {}
    for rank in range(len(projection)):
        reach = min(3.33, math.sqrt(2 * math.log(projection.opacities[rank].item() * 255)))
        bounds = []
        for axis in (0, 1):
            radius = math.ceil(reach * math.sqrt(projection.covariances[rank, 2 * axis].item()))
            centre = projection.means2d[rank, axis].item()
            most = math.ceil(size[axis] / 16)
            bounds.append(
                range(
                    min(max(0, math.floor((centre - radius) / 16)), most),
                    min(max(0, math.ceil((centre + radius) / 16)), most),
                )
            )
        for row in bounds[1]:
            for column in bounds[0]:
                found.setdefault((column, row), []).append(rank)
    return found


@pytest.mark.parametrize("size", SIZES)
def test_lanes_are_those_of_literal_loops(size: tuple[int, int]) -> None:
    gaussians = random_gaussians(120, 3, ("plain", "opacity 1", "needle", "behind"))
    gaussians.scales.mul_(5)  # so that tiles stop
    camera = make_camera(*size, focal=size[0])
    rows = {row["name"]: row for row in lanes.count_view(gaussians, camera, ALL)["rows"]}
    pixels = size[0] * size[1]

    preset = RASTER_PRESETS["inria"]
    projection = project_gaussians(gaussians, camera, preset)
    stopped = 0
    for tile in (8, 16):
        bins = bin_to_tiles(projection, *size, tile)
        evaluated, painting = dict.fromkeys((16, 32), 0), 0
        for number in range(bins.across * bins.down):
            ranks = bins.ranks[bins.starts[number] : bins.starts[number + 1]].tolist()
            row, column = divmod(number, bins.across)
            found = literal_tile(projection, ranks, column * tile, row * tile, tile, size, preset)
            painting += sum(sum(own) for own in found.values())
            longest = max(len(own) for own in found.values())
            stopped += longest < len(ranks)
            for chunk in evaluated:
                taken = 0
                while taken < longest:
                    taken += chunk
                evaluated[chunk] += taken * tile * tile
        for chunk, count in evaluated.items():
            row = rows[f"tile {tile}, chunk {chunk}"]
            assert row["pairs"] == len(bins.ranks)
            assert row["lanes"] == count / pixels
            assert row["painting"] == painting / pixels
    assert stopped > 0 or size[0] < 40, "the stop of a tile is to be tested, too"


@pytest.mark.parametrize("size", SIZES)
def test_steps_of_warps_are_those_of_literal_loops(size: tuple[int, int]) -> None:
    gaussians = random_gaussians(120, 5, ("plain", "opacity 1", "needle", "huge"))
    gaussians.scales.mul_(3)  # so that warps stop
    camera = make_camera(*size, focal=size[0])
    row = lanes.count_view(gaussians, camera, ALL)["rows"][-1]
    projection = project_gaussians(gaussians, camera, GSPLAT)
    lists = literal_lists(projection, size)
    assert row["pairs"] == sum(len(own) for own in lists.values())
    paint = skip = painting = stopped = 0
    for (column, row_of_tiles), ranks in lists.items():
        left, top = column * 16, row_of_tiles * 16
        found = literal_tile(projection, ranks, left, top, 16, size, GSPLAT)
        painting += sum(sum(own) for own in found.values())
        for first_row in range(top, top + 16, 2):
            warp = [own for (_, y), own in found.items() if first_row <= y < first_row + 2]
            longest = max((len(own) for own in warp), default=0)
            stopped += 0 < longest < len(ranks)
            for step in range(longest):
                if any(step < len(own) and own[step] for own in warp):
                    paint += 1
                else:
                    skip += 1
    pixels = size[0] * size[1]
    assert paint > 0
    assert skip > 0 or size[0] < 40
    assert stopped > 0 or size[0] < 40, "the stop of a warp is to be tested, too"
    assert row["painting_steps"] == 32 * paint / pixels
    assert row["skipping_steps"] == 32 * skip / pixels
    assert row["lanes"] == pytest.approx(32 * (paint + skip) / pixels)
    assert row["painting"] == painting / pixels


def test_tiles_of_any_size_paint_the_same() -> None:
    gaussians, camera = random_gaussians(300, 1), make_camera(70, 50)
    rows = lanes.count_view(gaussians, camera, ALL)["rows"]
    counted = count_evaluations(gaussians, camera) / (70 * 50)
    for row in rows[:-1]:
        assert row["painting"] == pytest.approx(counted, rel=1e-4)
        assert row["lanes"] >= row["painting"]
    assert rows[0]["lanes"] < rows[2]["lanes"]


def test_a_walk_does_not_depend_on_how_many_are_taken_at_once() -> None:
    gaussians = random_gaussians(200, 2, ("opacity 1",))
    camera = make_camera(40, 30)
    projection = project_gaussians(gaussians, camera, RASTER_PRESETS["inria"])
    bins = rectangles(projection, 40, 30)
    for tile in range(bins.across * bins.down):
        found = [
            walk(projection, bins, tile, 40, 30, RASTER_PRESETS["inria"], at_once) for at_once in (1, 7, 1024)
        ]
        for own in found[1:]:
            assert (own.seen == found[0].seen).all()
            assert (own.painting, own.painting_steps) == (found[0].painting, found[0].painting_steps)


def test_the_sample_is_of_the_same_pixels_for_all_tiles() -> None:
    gaussians, camera = random_gaussians(60, 0), make_camera(75, 50)
    few = lanes.count_view(gaussians, camera, 4, seed=1)
    assert (few["blocks"], few["of_blocks"]) == (4, 20)
    assert len({row["painting"] for row in few["rows"][:-1]}) == 1
    assert few == lanes.count_view(gaussians, camera, 4, seed=1)
    assert few != lanes.count_view(gaussians, camera, 4, seed=2)


def test_nobody_in_sight() -> None:
    rows = lanes.count_view(random_gaussians(20, 0, ("behind",)), make_camera(20, 10), ALL)["rows"]
    assert {(row["pairs"], row["lanes"], row["painting"]) for row in rows} == {(0, 0.0, 0.0)}


def test_the_lanes_of_every_kernel_are_counted(needs_triton: None) -> None:
    own = {
        (constants["TILE"], constants["CHUNK"])
        for *_, constants, _ in launches().values()
        if "CHUNK" in constants
    }
    assert own <= {(tile, chunk) for tile in lanes.TILES for chunk in lanes.CHUNKS}


def scene(name: str, lanes_a_pixel: float, painting: float, skipping: float) -> dict[str, Any]:
    ours = [
        {"name": f"tile 8, chunk {chunk}", "tile": 8, "chunk": chunk, "lanes": lanes_a_pixel + chunk}
        for chunk in (16, 32)
    ]
    gsplat = {"name": "gsplat", "tile": 16, "lanes": painting + skipping}
    return {"name": name, "rows": [*ours, {**gsplat, "painting_steps": painting, "skipping_steps": skipping}]}


def kernel(name: str, longest: int, shortest: int, turn: float, **ours: int) -> dict[str, Any]:
    return {
        "name": name, "instructions": longest, "lanes": turn, "shortest": shortest, "shortest_lanes": turn, **ours,
    }  # fmt: skip


def test_instructions_a_pixel() -> None:
    rows = [
        kernel("3 channels", 80, 80, 16, tile=8, chunk=16),
        kernel("codes 2 x 128", 32, 32, 16, tile=8, chunk=32),
        kernel("codes 1 x 128", 16, 16, 16, tile=8, chunk=32),
        kernel("codes 4 x 20", 16, 16, 16, tile=8, chunk=64),
        kernel("gsplat, forward, 32 channels", 100, 62, 2),
        kernel("gsplat, backward, 32 channels", 100, 62, 2),
        {"name": "broken", "reason": "does not compile", "tile": 8, "chunk": 16},
    ]
    views = a_pixel.a_pixel(rows, [scene("one", 100, 7, 3), scene("two", 200, 1, 0)])
    assert [view["name"] for view in views] == ["one", "two"]
    assert views[0]["instructions"] == {
        "3 channels": 116 * 5,
        "codes 2 x 128": 132 * 2,
        "codes 1 x 128": 132,
        "gsplat, forward, 32 channels": 7 * 50 + 3 * 31,
        "codes 3 x 128, as 2 and 1": 132 * 3,
        "gsplat, forward, 512 channels, 32 at a time": 16 * (7 * 50 + 3 * 31),
    }
    assert views[1]["instructions"]["gsplat, forward, 32 channels"] == 50
    lines = a_pixel.table(rows, views).splitlines()
    assert [cell.strip() for cell in lines[0].split("|")[1:-1]] == ["instructions a pixel", "one", "two"]
    assert [cell.strip() for cell in lines[2].split("|")[1:-1]] == ["3 channels", "580", "1,080"]
    assert len(lines) == 2 + len(views[0]["instructions"]) + 2
    assert lines[-1] == "lanes are not in the file for all views: codes 4 x 20 (tile 8, chunk 64)"


def test_chunks_are_filled_up() -> None:
    for seen, lanes_of_tile in ((0, 0), (1, 16), (16, 16), (17, 32)):
        tile = np.zeros((8, 8), np.int64)
        tile[3, 4] = seen
        assert chunked([Walk(tile, 0, 0)], 16) == lanes_of_tile * 64


def test_the_commands(needs_triton: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "lanes.json"
    room = ["--n-gaussians", "500", "700", "--width", "50", "--height", "40"]
    words = [*room, "--tiles", "5", "--json", str(out)]
    told = lanes.main(words)
    assert "room 500, 500 Gaussians, 50 x 40 pixels" in told
    assert "5 of 12 blocks" in told
    record = json.loads(out.read_text())
    assert [own["name"] for own in record["scenes"]] == ["room 500", "room 700"]
    assert record["scenes"] == a_pixel.read_lanes(out)
    with pytest.raises(OutputExistsError):
        lanes.main(words)

    monkeypatch.delenv("TRITON_INTERPRET", raising=False)
    row = kernel("3 channels", 706, 706, 16, tile=8, chunk=16)
    rest = {
        "groups": {},
        "registers": 1,
        "spilled": 0,
        "shared": 0,
        "warps_a_block": 2,
        "blocks": 1,
        "warps": 2,
    }
    rest |= {"powers": 16, "loops_inside": 0, "calls": 0, "unknown": []}
    monkeypatch.setattr(instructions, "count_ours", lambda *_: [{**row, **rest}])
    counted = tmp_path / "counted.json"
    told = instructions.main(["--lanes", str(out), "--json", str(counted)])
    expected = record["scenes"][0]["rows"][0]["lanes"] * 706 / 16
    third = told[told.index("| instructions a pixel") :].splitlines()
    assert [cell.strip() for cell in third[2].split("|")[1:3]] == ["3 channels", f"{expected:,.0f}"]
    assert json.loads(counted.read_text())["views"][0]["instructions"] == {"3 channels": expected}
    assert "instructions a pixel" not in instructions.main([])


def test_what_cannot_be_counted(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no folder kitchen/"):
        lanes.main(["--data", str(tmp_path)])
    with pytest.raises(InputError, match="--tiles must be 1 or more"):
        lanes.main(["--tiles", "0"])
    with pytest.raises(InputError, match="nothing to count"):
        lanes.main(["--n-gaussians"])
    file = tmp_path / "lanes.json"
    with pytest.raises(MissingFileError):
        a_pixel.read_lanes(file)
    file.write_text("{}")
    with pytest.raises(FileFormatError, match="does not hold lanes of views"):
        a_pixel.read_lanes(file)
    broken = scene("one", 1, 1, 1)
    del broken["rows"][-1]["painting_steps"]
    file.write_text(json.dumps({"what": lanes.WHAT, "scenes": [broken]}))
    with pytest.raises(FileFormatError, match="painting_steps"):
        a_pixel.read_lanes(file)
