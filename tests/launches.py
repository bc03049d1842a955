"""How the kernels of rasteriser and vote are launched: what it takes to compile them as they are run, without a GPU."""

from __future__ import annotations

from typing import Any

F32, I32, I64, HALF, U8, I8, I16, DOUBLE = "*fp32", "*i32", "*i64", "*fp16", "*u8", "*i8", "*i16", "*fp64"

LISTS = {"records": F32, "numbers": I32, "starts": I64}
SIZE = {"width": "i32", "height": "i32", "across": "i32"}
BOUNDS = {"alpha_max": "fp32", "stop": "fp32"}
CODES = {"words": I32, "n_levels": "i32", "n_atoms": "i32", "first_level": "i32", "out": F32}
TABLES = {"grams": HALF, "tables": HALF, "n_columns": "i32"}
SCENE = {"means": F32, "quats": F32, "scales": F32, "opacities": F32, "camera": DOUBLE}


def launches() -> dict[str, tuple[Any, dict[str, str], dict[str, Any], int]]:
    """By name: kernel, types, constants and warps, as they are launched in ``scoup.raster`` and ``scoup.uplift``."""
    from scoup.raster.triton import region_sums as gpu_regions
    from scoup.raster.triton import rendering as gpu
    from scoup.raster.triton.kernels import channels, codes, products, projection, regions
    from scoup.raster.triton.projection import TILE
    from scoup.uplift.vote_backends import kernels as vote_kernel
    from scoup.uplift.vote_backends import triton as vote_triton

    blended = {"STOP_INCLUSIVE": False, "TILE": TILE}
    found: dict[str, tuple[Any, dict[str, str], dict[str, Any], int]] = {}
    for n_channels in (3, 64):
        blocks = gpu.channel_blocks(n_channels)
        types = {**LISTS, **SIZE, **BOUNDS, "values": F32, "image": F32, "coverage": F32, "n_channels": "i32"}
        constants = {**blended, "CHUNK": blocks.chunk, "CHANNELS": blocks.channels, "PRECISION": "tf32x3"}
        found[f"{n_channels} channels"] = channels.channels_kernel, types, constants, blocks.warps
    for levels, n_atoms in ((3, 64), (2, 128), (1, 128), (1, 256), (4, 20)):
        constants = {**blended, **_of_codes(levels, n_atoms)}
        types = {**LISTS, **SIZE, **BOUNDS, **CODES}
        found[f"codes {levels} x {n_atoms}"] = codes.codes_kernel, types, constants, gpu.WARPS
        found[f"cosines {levels} x {n_atoms}"] = (
            products.products_kernel, {**types, **TABLES}, {**constants, **_table(True)}, gpu.WARPS,
        )  # fmt: skip
    for n_atoms, precision in ((64, "ieee"), (128, "tf32x3")):
        constants = {**blended, **_of_codes(1, n_atoms, precision)}
        types = {**LISTS, **SIZE, **BOUNDS, **CODES, "words": I64}
        found[f"codes 1 x {n_atoms} in {precision}"] = codes.codes_kernel, types, constants, gpu.WARPS
    for levels, n_atoms in ((1, 64), (3, 64), (2, 128), (1, 256)):
        constants = {**blended, **_of_codes(levels, n_atoms), **_table(False)}
        types = {**LISTS, **SIZE, **BOUNDS, **CODES, **TABLES}
        found[f"features {levels} x {n_atoms}"] = products.products_kernel, types, constants, gpu.WARPS
    types = {"indices": U8, "weights": HALF, "words": I32, "n_codes": "i32", "n_atoms": "i32"}
    constants = {"K": 4, "GROUPS": 1, "WIDE": False, "BLOCK": 128}
    found["pack"] = codes.pack_kernel, types, constants, 4
    of_tiles = {"columns": I16, "combinations": I32, "n_columns": I32}
    types = {**of_tiles, **SIZE, "labels": I32, "starts": I64, "room": I64}
    found["columns"] = regions.columns_kernel, types, {"TILE": TILE}, 4
    entries = {"keys": I32, "weights": I64, "n_entries": I32, "ends": I64}
    entries |= {"first_tile": "i32", "before": "i32"}
    constants = {**blended, "CHUNK": gpu_regions.CHUNK, "COLUMNS": gpu_regions.COLUMNS}
    types = {**LISTS, **of_tiles, **entries, **SIZE, **BOUNDS, "n_combinations": "i32", "scale": "fp32"}
    found["region sums"] = regions.region_sums_kernel, types, constants, gpu_regions.WARPS
    ends = {"entries_end": I64, "keys_out": I32, "weights_out": I64}
    types = {"starts": I64, "n_columns": I32, **entries, **ends}
    found["gather"] = regions.gather_kernel, types, {"BLOCK": 256}, 4
    types = {"keys": I32, "totals": I64, "gaussians": I32, "combinations": I32, "weights": F32}
    types |= {"count": "i32", "n_combinations": "i32", "scale": "fp32"}
    found["unpack"] = regions.unpack_kernel, types, {"BLOCK": 256}, 4
    types = {
        "starts": I64, "combinations": I32, "shares": F32, "rows": I32, "atoms": I32, "weights": F32,
        "inverse_norms": F32, "grams": F32, "earlier_atoms": I32, "earlier_weights": F32, "sharpness": F32, "out": F32,
        "kept": I32, "n_levels": "i32", "n_atoms": "i32",
    }  # fmt: skip
    for n_atoms, earlier_k, keep in ((64, 0, 4), (128, 4, 4), (1024, 4, 0)):
        constants = {"K": 4, "EARLIER_K": earlier_k, "KEEP": keep, **vote_triton.blocks(n_atoms)}
        warps = constants.pop("num_warps")
        name = f"vote, {n_atoms} atoms, {earlier_k} earlier"
        found[name] = vote_kernel.vote_kernel, types, constants, warps
    types = {name: SCENE[name] for name in ("means", "scales", "opacities", "camera")}
    found["sieve"] = projection.sieve_kernel, {**types, "keep": I8, "count": "i32"}, {"BLOCK": 128}, 4
    visible = {"geometry": DOUBLE, "centres": DOUBLE, "rects": I32, "across": "i32", "down": "i32"}
    seen = {"shapes": F32, "ids": I64, "depths": DOUBLE, "counts": I32, "n_visible": "i32"}
    types = {**SCENE, **visible, **seen}
    found["project"] = projection.project_kernel, types, {"TILE": TILE, "BLOCK": 128}, 4
    lists = {"tiles": I16, "slots": I32, "n_candidates": "i32"}
    types = {**visible, **lists, "camera": DOUBLE, "ranks": I64, "order": I64, "firsts": I64}
    found["expand"] = projection.expand_kernel, types, {"TILE": TILE, "BLOCK": 128}, 4
    types = {
        **lists, "shapes": F32, "centres": DOUBLE, "across": "i32", "down": "i32", "by_tile": I64, "ids": I64,
        "records": F32, "n_records": "i32",
    }  # fmt: skip
    found["list"] = projection.list_kernel, types, {"TILE": TILE, "BLOCK": 128}, 4
    return found


def _of_codes(levels: int, n_atoms: int, precision: Any = "fp16x3") -> dict[str, Any]:
    from scoup.raster.triton import rendering as gpu

    blocks = gpu.code_blocks(levels, n_atoms, precision)
    assert blocks.levels == levels, "more than a program renders"
    sizes = {"CHUNK": blocks.chunk, "LEVELS": levels, "GROUPS": 1, "ATOMS": blocks.atoms}
    return {**sizes, "WIDE": precision != "fp16x3", "PRECISION": precision}


def _table(pixels_last: bool) -> dict[str, Any]:
    from scoup.raster.triton import rendering as gpu

    return {"COLUMNS": gpu.COLUMNS, "PIXELS_LAST": pixels_last}
