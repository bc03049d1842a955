"""OpenUSD files of Gaussians (.usd, .usda, .usdc, .usdz), written by the package usd-core (extra ``scoup[usd]``).

One prim of the type ParticleField3DGaussianSplat, which OpenUSD has from 26.03 on; with things, one for each and one
for the rest. They are not read.
"""

from __future__ import annotations

import shutil
import struct
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError, ScoupError, WriteError, atomic_path
from scoup.io.splats.activation import finite_arrays
from scoup.io.splats.axes import Axis, half_turn, turned_direction, upright
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene import Gaussians

HOW_TO_GET_IT = "needs the package usd-core, 26.3 or newer: pip install 'scoup[usd]', and run again"
SPLAT, SCENE = "/Splat", "/Scene"
TAXONOMY = "class"
"""Of labels of things: the attribute is ``semantics:labels:class``."""
_AXIS: Axis = "x"
_TYPE = "ParticleField3DGaussianSplat"
_ALIGNED, _PADDING = 64, 0x1986  # of .usdz: where a file begins, and the id of what fills the place before it
_ZIP_HEADER = 30  # bytes
_EXTENT = 3.0  # standard deviations within which a Gaussian is drawn


@dataclass(frozen=True, eq=False)
class UsdThing:
    """A thing that gets a prim of its own: a label, its Gaussians, and a box to collide with."""

    label: str
    number: int  # no two things have the same label and number
    members: Tensor  # [N] boolean; no Gaussian belongs to two things
    centre: Tensor  # [3] of the box, as all in the axes of the Gaussians
    axes: Tensor  # [3, 3] one unit direction per row, right-handed
    extent: Tensor  # [3] full lengths along the axes


def write_usd(
    gaussians: Gaussians, path: str | Path, overwrite: bool = False, things: Sequence[UsdThing] = ()
) -> None:
    """Write an OpenUSD file; the suffix decides between text (.usda), binary (.usd, .usdc) and a package (.usdz).

    All float32 values are kept bit by bit, but for what ``finite_arrays`` changes. Axes are turned to those of a stage
    with y up (right, up, back) by signs (``axes``). With a frame of the world the stage is upright and has the
    metres of its unit, else 1. A ScoupError if usd-core is missing or too old.

    Args:
        gaussians: at least one; rows that are not finite are refused.
        things: of them.
    """
    path = Path(path)
    usd = _package(path)
    if not len(gaussians):
        raise InputError(f"{path}: there are no Gaussians to write")
    arrays = half_turn(finite_arrays(gaussians, path), _AXIS)
    tensors = (torch.from_numpy(array).float() for array in arrays.values())
    finite = Gaussians(*tensors, world=gaussians.world)
    with atomic_path(path, overwrite) as temporary:
        is_package = path.suffix.lower() == ".usdz"
        # A short name: usd-core writes to a longer one first.
        layer = temporary.with_name("splat.usdc" if is_package else f"splat{path.suffix}")
        # Kept until the end: without it the layer crashes the process.
        stage = _stage(usd, finite, things)
        try:
            stage.GetRootLayer().Export(str(layer))
        except usd.Tf.ErrorException:  # it names places in its sources, and not what the system said
            remedy = "check the free space and that the folder may be written"
            raise WriteError(path, "usd-core cannot write it", remedy) from None
        if is_package:
            _pack(layer, temporary, path)
        else:
            layer.replace(temporary)


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
    try:
        package: Any = import_module("pxr")
        for name in ("Gf", "Tf", "Usd", "UsdGeom", "UsdPhysics", "UsdSemantics", "UsdVol", "Vt"):
            import_module(f"pxr.{name}")
    except ImportError:
        raise ScoupError(f"{path}: {HOW_TO_GET_IT}") from None
    if not hasattr(package.UsdVol, _TYPE):
        raise ScoupError(f"{path}: {HOW_TO_GET_IT}")
    return package


def _stage(usd: Any, gaussians: Gaussians, things: Sequence[UsdThing]) -> Any:
    stage = usd.Usd.Stage.CreateInMemory()
    usd.UsdGeom.SetStageUpAxis(stage, usd.UsdGeom.Tokens.y)
    usd.UsdGeom.SetStageMetersPerUnit(stage, gaussians.world.metres_per_unit or 1.0)
    if things:
        root = usd.UsdGeom.Xform.Define(stage, SCENE).GetPrim()
    else:
        root = _define_splat(usd, stage, SPLAT, gaussians)
    stage.SetDefaultPrim(root)
    matrix = np.eye(4)
    matrix[:3, :3] = upright(gaussians.world, _AXIS).T  # of row vectors
    if (matrix != np.eye(4)).any():
        usd.UsdGeom.Xformable(root).AddTransformOp().Set(usd.Gf.Matrix4d(*matrix.tolist()))
    if not things:
        return stage
    rest = torch.ones(len(gaussians), dtype=torch.bool)
    for thing in things:
        if not thing.members.any():
            continue
        name = usd.Tf.MakeValidIdentifier(thing.label)
        while stage.GetPrimAtPath(path := f"{SCENE}/{name}_{thing.number}"):
            name += "_"  # another label with the same identifier
        prim = usd.UsdGeom.Xform.Define(stage, path).GetPrim()
        usd.UsdSemantics.LabelsAPI.Apply(prim, TAXONOMY).CreateLabelsAttr([thing.label])
        _define_splat(usd, stage, path + SPLAT, gaussians.select(thing.members))
        _define_collider(usd, stage, f"{path}/Box", thing)
        rest &= ~thing.members
    if rest.any():
        _define_splat(usd, stage, f"{SCENE}/Rest", gaussians.select(rest))
    return stage


def _define_splat(usd: Any, stage: Any, path: str, gaussians: Gaussians) -> Any:
    """Add a prim of at least one Gaussian, and return it."""
    prim = usd.UsdVol.ParticleField3DGaussianSplat.Define(stage, path).GetPrim()
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
        prim.GetAttribute(name).Set(value)
    return prim


def _define_collider(usd: Any, stage: Any, path: str, thing: UsdThing) -> None:
    """Add the box of a thing: other bodies collide with it, and only views of guides show it."""
    cube = usd.UsdGeom.Cube.Define(stage, path)
    cube.CreateSizeAttr(1.0)
    cube.CreateExtentAttr([(-0.5,) * 3, (0.5,) * 3])
    cube.CreatePurposeAttr(usd.UsdGeom.Tokens.guide)
    rows = [*(thing.axes * thing.extent[:, None]).tolist(), thing.centre.tolist()]
    turned = [(*turned_direction(row, _AXIS), float(number == 3)) for number, row in enumerate(rows)]
    cube.AddTransformOp().Set(usd.Gf.Matrix4d(*turned))
    usd.UsdPhysics.CollisionAPI.Apply(cube.GetPrim())


FORMAT = SplatFormat("OpenUSD", (".usd", ".usda", ".usdc", ".usdz"), write=write_usd, axis=_AXIS, extra="usd")
