"""OpenUSD files, read back with usd-core itself."""

from __future__ import annotations

import sys
import zipfile
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch

from io_samples import heights, some_gaussians
from messages import refuses
from scoup.base import ScoupError, WorldFrame, WriteError
from scoup.io import save_gaussians
from scoup.io.splats import usd
from scoup.io.splats.axes import turned

pytest.importorskip("pxr", reason="usd-core is not installed")
Tf, Usd, UsdGeom, UsdValidation, UsdVol = (
    cast(Any, import_module(f"pxr.{name}")) for name in ("Tf", "Usd", "UsdGeom", "UsdValidation", "UsdVol")
)
SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
STAGES: list[Any] = []


def read(path: Path) -> Any:
    """The default prim. Its stage is kept with it, since it would end with it."""
    stage = Usd.Stage.Open(str(path))
    STAGES.append(stage)
    return stage.GetDefaultPrim()


def attribute(prim: Any, name: str) -> np.ndarray:
    return np.array(prim.GetAttribute(name).Get())


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("degree", [0, 3])
def test_values_keep_their_bits_in_a_stage_with_y_up(tmp_path: Path, suffix: str, degree: int) -> None:
    given, path = (
        some_gaussians(40, degree),
        tmp_path / ("a" * (255 - len(suffix)) + suffix),
    )  # the longest name
    save_gaussians(given, path)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
    prim = read(path)
    stage = prim.GetStage()
    checks = UsdValidation.ValidationContext(UsdValidation.ValidationRegistry().GetOrLoadAllValidators())
    assert [error.GetMessage() for error in checks.Validate(stage)] == []
    assert UsdGeom.GetStageUpAxis(stage) == "Y"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert prim.IsA(UsdVol.ParticleField3DGaussianSplat)
    wanted = turned(given, "x")
    np.testing.assert_array_equal(attribute(prim, "positions"), given.means.numpy() * [1, -1, -1])
    np.testing.assert_array_equal(attribute(prim, "scales"), given.scales.numpy())
    np.testing.assert_array_equal(attribute(prim, "opacities"), given.opacities.numpy())
    quats = [[q.GetReal(), *q.GetImaginary()] for q in prim.GetAttribute("orientations").Get()]
    np.testing.assert_allclose(quats, wanted.quats.numpy(), atol=1e-7)
    assert prim.GetAttribute("radiance:sphericalHarmonicsDegree").Get() == degree
    sh = attribute(prim, "radiance:sphericalHarmonicsCoefficients")
    np.testing.assert_array_equal(sh.reshape(wanted.sh.shape), wanted.sh.numpy())
    low, high = attribute(prim, "extent")
    assert (low < attribute(prim, "positions").min(0)).all()
    assert (high > attribute(prim, "positions").max(0)).all()
    save_gaussians(given, tmp_path / f"b{suffix}", keep_axes=True)
    np.testing.assert_array_equal(attribute(read(tmp_path / f"b{suffix}"), "positions"), given.means.numpy())


def test_a_stage_is_upright_and_says_its_metres(tmp_path: Path) -> None:
    given = replace(some_gaussians(9, 1), world=WorldFrame(0.25, (0.1, -0.9, 0.2)))
    save_gaussians(given, tmp_path / "a.usda")
    prim = read(tmp_path / "a.usda")
    assert UsdGeom.GetStageMetersPerUnit(prim.GetStage()) == 0.25
    matrix = np.array(UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(0))
    upwards = attribute(prim, "positions").astype(np.float64) @ matrix[:3, 1]
    np.testing.assert_allclose(upwards * 0.25, heights(given), rtol=1e-5)
    assert np.linalg.det(matrix) == pytest.approx(1)


def test_a_package_begins_at_byte_64_and_has_no_time_of_day(tmp_path: Path) -> None:
    for name in ("a.usdz", "b.usdc"):
        save_gaussians(some_gaussians(20), tmp_path / name)
    with zipfile.ZipFile(tmp_path / "a.usdz") as package:
        (entry,) = package.infolist()
    assert (entry.compress_type, entry.date_time) == (zipfile.ZIP_STORED, (1980, 1, 1, 0, 0, 0))
    assert (tmp_path / "a.usdz").read_bytes()[64 : 64 + entry.file_size] == (tmp_path / "b.usdc").read_bytes()


def test_what_the_format_has_no_place_for(tmp_path: Path) -> None:
    given = some_gaussians(5)
    odd = replace(given, quats=given.quats * 3, opacities=torch.tensor([2.0, -1.0, 0.5, torch.inf, 0.25]))
    save_gaussians(odd, tmp_path / "a.usdc")
    prim = read(tmp_path / "a.usdc")
    assert attribute(prim, "opacities").tolist() == [1.0, 0.0, 0.5, 1.0, 0.25]
    lengths = [q.GetLength() for q in prim.GetAttribute("orientations").Get()]
    np.testing.assert_allclose(lengths, 1, atol=1e-6)


def test_a_refusal_of_the_system_is_one_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*given: Any) -> Any:
        class Stage:
            def GetRootLayer(self) -> Any:  # as usd-core has it
                raise Tf.ErrorException("Error in 'CrateFile' at line 7")

        return Stage()

    monkeypatch.setattr(usd, "_stage", refuse)
    with refuses(WriteError):
        save_gaussians(some_gaussians(5), tmp_path / "a.usda")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pxr", None)
    with refuses(ScoupError):
        save_gaussians(some_gaussians(5), tmp_path / "a.usda")
