"""Gaussians as SceneSplat's arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from scoup.base.errors import FileFormatError, MissingFileError, OutputExistsError, ScoupWarning
from scoup.io import load_gaussians, splat_source
from scoup.io.splats.scenesplat import read_scenesplat, write_scenesplat
from scoup.scene.gaussians import SH_C0, Gaussians


def written(folder: Path, count: int = 6) -> Gaussians:
    generator = torch.Generator().manual_seed(0)
    quats = torch.nn.functional.normalize(torch.randn(count, 4, generator=generator), dim=1)
    colors = torch.randint(0, 256, (count, 1, 3), generator=generator) / 255
    gaussians = Gaussians(
        torch.randn(count, 3, generator=generator),
        quats,
        torch.rand(count, 3, generator=generator) * 0.1,
        torch.rand(count, generator=generator),
        (colors - 0.5) / SH_C0,
    )
    write_scenesplat(gaussians, folder)
    return gaussians


def test_what_is_written_is_read(tmp_path: Path) -> None:
    gaussians = written(tmp_path)
    assert np.load(tmp_path / "color.npy").dtype == np.uint8
    found = load_gaussians(tmp_path)
    for name in ("means", "scales", "opacities"):
        assert getattr(found, name).equal(getattr(gaussians, name))
    assert torch.allclose(found.quats, gaussians.quats, atol=1e-6)
    assert torch.allclose(found.sh, gaussians.sh, atol=1.1 / 255 / SH_C0)
    assert splat_source(tmp_path).path == tmp_path
    assert splat_source(tmp_path).preset == "gsplat"
    with pytest.raises(OutputExistsError):
        write_scenesplat(gaussians, tmp_path)


def test_opacities_may_be_a_column(tmp_path: Path) -> None:
    gaussians = written(tmp_path)
    np.save(tmp_path / "opacity.npy", gaussians.opacities.numpy()[:, None].astype(np.float16))
    assert torch.allclose(load_gaussians(tmp_path).opacities, gaussians.opacities, atol=1e-3)


def test_points_alone_are_no_gaussians(tmp_path: Path) -> None:
    np.save(tmp_path / "coord.npy", np.ones((2, 3)))
    with pytest.raises(MissingFileError, match="no trained splat"):
        load_gaussians(tmp_path)


def test_rows_that_are_not_finite_are_dropped(tmp_path: Path) -> None:
    written(tmp_path)
    means = np.load(tmp_path / "coord.npy")
    means[2] = np.nan
    np.save(tmp_path / "coord.npy", means)
    with pytest.warns(ScoupWarning, match="dropped 1 of 6"):
        assert len(load_gaussians(tmp_path)) == 5


@pytest.mark.parametrize(
    ("name", "values", "problem"),
    [
        ("quat", np.ones((6, 3), np.float32), r"is \[6, 3\], expected \[Gaussians, 4\]"),
        ("scale", np.ones((5, 3), np.float32), "has 5 rows, coord.npy has 6"),
        ("scale", np.full((6, 3), -4.0), "not logarithms"),
        ("opacity", np.full(6, -2.0), "negative"),
        ("color", np.array([None] * 6), "plain numbers"),
    ],
)
def test_other_arrays_are_refused(tmp_path: Path, name: str, values: np.ndarray, problem: str) -> None:
    written(tmp_path)
    np.save(tmp_path / f"{name}.npy", values)
    with pytest.raises(FileFormatError, match=problem):
        read_scenesplat(tmp_path)


def test_a_missing_array_is_named(tmp_path: Path) -> None:
    written(tmp_path)
    (tmp_path / "scale.npy").unlink()
    with pytest.raises(MissingFileError, match=r"scale\.npy"):
        load_gaussians(tmp_path)
