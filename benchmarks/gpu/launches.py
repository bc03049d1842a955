"""How the rasteriser's kernels are launched: what it takes to compile them as they are run, without a GPU."""

from __future__ import annotations

from typing import Any

F32, I32, I64, HALF, U8, I8, I16, DOUBLE = "*fp32", "*i32", "*i64", "*fp16", "*u8", "*i8", "*i16", "*fp64"

LISTS = {"pair_ids": I32, "corners": F32, "records": F32, "starts": I64}
SIZE = {"width": "i32", "height": "i32", "across": "i32"}
BOUNDS = {"alpha_max": "fp32", "stop": "fp32"}
CODES = {
    "indices": U8,
    "weights": HALF,
    "n_levels": "i32",
    "n_atoms": "i32",
    "first_level": "i32",
    "out": F32,
}
TABLES = {"grams": F32, "tables": F32, "n_columns": "i32"}
VOTES = {
    "chosen": I64, "ids": I64, "firsts": I64, "tiles": I16, "places": I32, "starts": I64, "n_columns": I32,
    "bases": I64, "sums": F32, "first_columns": I64, "column_regions": I32, "first_rows": I64, "atoms": I32,
    "weights": F32, "earlier_atoms": U8, "earlier_weights": F32, "region_cosines": F32, "sharpness": F32, "out": F32,
    "n_levels": "i32", "n_tiles": "i32", "n_atoms": "i32",
}  # fmt: skip
SCENE = {"means": F32, "quats": F32, "scales": F32, "opacities": F32, "camera": DOUBLE}


def launches() -> dict[str, tuple[Any, dict[str, str], dict[str, Any], int]]:
    """By name: kernel, types, constants and warps, as ``scoup.raster.gpu`` launches them."""
    from scoup.raster import gpu, gpu_regions
    from scoup.raster.gpu_view import TILE
    from scoup.raster.kernels import projection, regions, rendering, votes

    blended = {"STOP_INCLUSIVE": False, "TILE": TILE, "CHUNK": 16, "PRECISION": "fp16x3"}
    found: dict[str, tuple[Any, dict[str, str], dict[str, Any], int]] = {}
    for channels, pixels in ((16, 256), (64, 128)):
        types = {**LISTS, **SIZE, **BOUNDS, "values": F32, "image": F32, "coverage": F32, "n_channels": "i32"}
        constants = {**blended, "PRECISION": "tf32x3", "PIXELS": pixels, "CHANNELS": channels}
        found[f"{channels} channels"] = rendering.channels_kernel, types, constants, 8
    for levels, n_atoms in ((3, 64), (3, 128), (1, 256), (4, 20)):
        blocks = gpu.code_blocks(levels, n_atoms)
        sizes = {"PIXELS": blocks.pixels, "LEVELS": blocks.levels, "K": 4, "ATOMS": blocks.atoms}
        types, constants = {**LISTS, **SIZE, **BOUNDS, **CODES}, {**blended, **sizes}
        found[f"codes {levels} x {n_atoms}"] = rendering.codes_kernel, types, constants, gpu.WARPS
        asked = {**constants, "COLUMNS": 16, "PIXELS_LAST": True, "TABLE_PRECISION": "fp16x3"}
        found[f"cosines {levels} x {n_atoms}"] = (
            rendering.products_kernel, {**types, **TABLES}, asked, gpu.WARPS,
        )  # fmt: skip
    for n_atoms in (64, 256):
        blocks = gpu.code_blocks(1, n_atoms)
        sizes = {"PIXELS": blocks.pixels, "LEVELS": 1, "K": 4, "ATOMS": n_atoms, "PIXELS_LAST": False}
        columns = gpu.product_columns(blocks, pixels_last=False)
        constants = {**blended, **sizes, "COLUMNS": columns, "TABLE_PRECISION": "fp16x3"}
        types = {**LISTS, **SIZE, **BOUNDS, **CODES, **TABLES}
        found[f"features 1 x {n_atoms}"] = rendering.products_kernel, types, constants, gpu.WARPS
    types = {**LISTS, **SIZE, **BOUNDS, "columns": I16, "n_columns": I32, "bases": I64, "sums": F32}
    constants = {**blended, "CHUNK": 32, "COLUMNS": 16}
    found["region sums"] = regions.region_sums_kernel, {**types, "first_tile": "i32"}, constants, 8
    types = {"labels": I32, "first_alike": I32, **SIZE, "n_levels": "i32"}
    found["alike"] = regions.alike_kernel, types, {"TILE": TILE, "OTHERS": 32}, 4
    types = {**VOTES, "n_chosen": "i32"}
    for earlier_k in (0, 4):
        sizes = {"K": 4, "EARLIER_K": earlier_k}
        found[f"few votes, {earlier_k} earlier"] = votes.add_few_kernel, types, {**sizes, "BLOCK": 32}, 1
        constants = {**sizes, "PAIRS": gpu_regions.pairs_at_once(128), "ATOMS": 128}
        found[f"many votes, {earlier_k} earlier"] = votes.add_many_kernel, VOTES, constants, 4
    types = {name: SCENE[name] for name in ("means", "scales", "opacities", "camera")}
    found["sieve"] = projection.sieve_kernel, {**types, "keep": I8, "count": "i32"}, {"BLOCK": 128}, 4
    visible = {"ids": I64, "rects": I32, "geometry": DOUBLE, "across": "i32", "down": "i32"}
    types = {**SCENE, **visible, "depths": DOUBLE, "counts": I32, "records": F32, "n_visible": "i32"}
    found["project"] = projection.project_kernel, types, {"TILE": TILE, "BLOCK": 128}, 4
    types = {
        **visible, "camera": DOUBLE, "ranks": I64, "order": I64, "firsts": I64, "tiles": I16, "pair_ids": I32,
        "corners": F32, "n_pairs": "i32",
    }  # fmt: skip
    found["expand"] = projection.expand_kernel, types, {"TILE": TILE, "BLOCK": 128}, 4
    return found
