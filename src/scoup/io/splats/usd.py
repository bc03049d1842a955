"""OpenUSD files of Gaussians (.usd, .usda, .usdc, .usdz), written by the package usd-core (extra ``scoup[usd]``).

One prim of the type ParticleField3DGaussianSplat, which OpenUSD has from 26.03 on. They are not read.
"""

from __future__ import annotations

import shutil
import struct
import zipfile
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from scoup.base.atomic import atomic_path
from scoup.base.errors import InputError, ScoupError, WriteError
from scoup.io.splats.activation import keep_finite, linear_arrays
from scoup.io.splats.axes import Axis, half_turn
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene.gaussians import Gaussians

HOW_TO_GET_IT = "needs the package usd-core, 26.3 or newer: pip install 'scoup[usd]', and run again"
PRIM = "/Splat"
_AXIS: Axis = "x"
_TYPE = "ParticleField3DGaussianSplat"
_ALIGNED, _PADDING = 64, 0x1986  # of .usdz: where a file begins, and the id of what fills the place before it
_ZIP_HEADER = 30  # bytes
_EXTENT = 3.0  # standard deviations within which a Gaussian is drawn


def write_usd(gaussians: Gaussians, path: str | Path, overwrite: bool = False) -> None:
    """Write an OpenUSD file; the suffix decides between text (.usda), binary (.usd, .usdc) and a package (.usdz).

    All float32 values are kept bit by bit, but for what ``linear_arrays`` changes. Rows that are not finite are left
    out. Axes are turned to those of a stage with y up (right, up, back) by signs (``axes``); a unit is a metre.

    Args:
        gaussians: at least one.

    Raises:
        ScoupError: usd-core is missing or too old.

    Warns:
        ScoupWarning: rows were left out.
    """
    path = Path(path)
    usd = _package(path)
    finite = keep_finite(**half_turn(linear_arrays(gaussians), _AXIS), source=str(path))[0]
    if not len(finite):
        raise InputError(f"{path}: there are no Gaussians to write")
    with atomic_path(path, overwrite) as temporary:
        is_package = path.suffix.lower() == ".usdz"
        layer = temporary.with_suffix(".usdc") if is_package else temporary
        stage = _stage(usd, finite)  # kept until the end: without it the layer crashes the process
        try:
            stage.GetRootLayer().Export(str(layer))
        except usd.Tf.ErrorException:  # it names places in its sources, and not what the system said
            remedy = "check the free space and that the folder may be written"
            raise WriteError(path, "usd-core cannot write it", remedy) from None
        if is_package:
            _pack(layer, temporary, path)


def _pack(layer: Path, package: Path, path: Path) -> None:
    """Write a .usdz file of one layer: uncompressed, from byte 64 on. (usd-core's own has the time of day in it, and
    is cut short silently on a full disk.)"""
    entry = zipfile.ZipInfo("splat.usdc")
    padding = _ALIGNED - _ZIP_HEADER - len(entry.filename) - 4
    entry.extra = struct.pack("<HH", _PADDING, padding) + bytes(padding)
    entry.file_size = layer.stat().st_size
    try:
        with (
            layer.open("rb") as source,
            zipfile.ZipFile(package, "w", allowZip64=False) as archive,
            archive.open(entry, "w") as target,
        ):
            shutil.copyfileobj(source, target)
    except zipfile.LargeZipFile:
        raise InputError(f"{path}: a .usdz file cannot be larger than 2 GiB; use .usdc") from None


def _package(path: Path) -> Any:
    """Return usd-core."""
    try:
        package: Any = import_module("pxr")
        for name in ("Tf", "Usd", "UsdGeom", "UsdVol", "Vt"):
            import_module(f"pxr.{name}")
    except ImportError:
        raise ScoupError(f"{path}: {HOW_TO_GET_IT}") from None
    if not hasattr(package.UsdVol, _TYPE):
        raise ScoupError(f"{path}: {HOW_TO_GET_IT}")
    return package


def _stage(usd: Any, gaussians: Gaussians) -> Any:
    """Return a stage in memory, with the Gaussians as its default prim."""
    stage = usd.Usd.Stage.CreateInMemory()
    usd.UsdGeom.SetStageUpAxis(stage, usd.UsdGeom.Tokens.y)
    usd.UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    splat = usd.UsdVol.ParticleField3DGaussianSplat.Define(stage, PRIM)
    stage.SetDefaultPrim(splat.GetPrim())
    means, scales, sh = (getattr(gaussians, name).numpy() for name in ("means", "scales", "sh"))
    reach = _EXTENT * scales.max(1, keepdims=True)
    vectors, numbers = usd.Vt.Vec3fArray.FromNumpy, usd.Vt.FloatArray.FromNumpy
    for name, value in {
        "extent": vectors(np.stack([(means - reach).min(0), (means + reach).max(0)])),
        "positions": vectors(means),
        "orientations": usd.Vt.QuatfArray.FromNumpy(np.roll(gaussians.quats.numpy(), -1, axis=1)),
        "scales": vectors(scales),
        "opacities": numbers(gaussians.opacities.numpy()),
        "radiance:sphericalHarmonicsDegree": gaussians.sh_degree,
        "radiance:sphericalHarmonicsCoefficients": vectors(sh.reshape(-1, 3)),
    }.items():
        splat.GetPrim().GetAttribute(name).Set(value)
    return stage


FORMAT = SplatFormat("OpenUSD", (".usd", ".usda", ".usdc", ".usdz"), write=write_usd, axis=_AXIS, extra="usd")
