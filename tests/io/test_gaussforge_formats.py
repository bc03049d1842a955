""".ksplat and .sog, through gaussforge: what becomes of the values, and a converter that crashes."""

from __future__ import annotations

import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from io_samples import angles, save_spz, tame
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupError, ScoupWarning
from scoup.io import load_gaussians, save_gaussians
from scoup.io.splats import gaussforge_formats

gaussforge = pytest.importorskip("gaussforge", reason="gaussforge is not installed")


def test_an_unbundled_sog(tmp_path: Path) -> None:
    save_gaussians(tame(300, 1, 3, 10.0), tmp_path / "a.sog")
    folder = tmp_path / "sog"
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        archive.extractall(folder)
    for path in (folder, folder / "meta.json"):
        assert load_gaussians(path).fingerprint() == load_gaussians(tmp_path / "a.sog").fingerprint()
    content = (folder / "meta.json").read_text()
    for change, said in (("scales.webp", "../a.webp"), ("means", "other")):
        (folder / "meta.json").write_text(content.replace(change, said))
        with refuses(FileFormatError):
            load_gaussians(folder / "meta.json")
    (folder / "meta.json").write_text(content)
    next(folder.glob("sh0*.webp")).unlink()
    with refuses(MissingFileError):
        load_gaussians(folder)


@pytest.mark.parametrize(("ending", "version"), [("compressed.ply", 0), ("spz", 2), ("spz", 3), ("spz", 4)])
def test_an_independent_library_reads_and_writes_the_same(tmp_path: Path, ending: str, version: int) -> None:
    given, path, library = tame(700, 3, 7), tmp_path / f"a.{ending}", gaussforge.GaussForge()
    if version:
        save_spz(given, path, version)
    else:
        save_gaussians(given, path, keep_axes=True)
    (tmp_path / "b.ply").write_bytes(library.convert(path.read_bytes(), ending, "ply")["data"])
    ours, theirs = (load_gaussians(each, keep_axes=True) for each in (path, tmp_path / "b.ply"))
    torch.testing.assert_close(theirs.means, ours.means, rtol=1e-4, atol=1e-5)
    torch.testing.assert_close(theirs.scales, ours.scales, rtol=1e-4, atol=0)
    torch.testing.assert_close(theirs.sh, ours.sh, rtol=1e-4, atol=1e-5)
    # In compressed PLY it keeps them away from 0 and 1.
    torch.testing.assert_close(theirs.opacities, ours.opacities, rtol=0, atol=1e-4 if version else 2e-3)
    assert float(angles(theirs.quats, ours.quats).max()) < 0.1
    if version == 3:
        save_gaussians(given, tmp_path / "c.ply")
        path.write_bytes(library.convert((tmp_path / "c.ply").read_bytes(), "ply", ending)["data"])
        written = load_gaussians(path, keep_axes=True)
        torch.testing.assert_close(written.means, given.means, rtol=0, atol=2**-12)
        torch.testing.assert_close(written.opacities, given.opacities, rtol=0, atol=1e-2)


def test_a_converter_that_crashes_or_hangs_is_a_refusal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.sog").write_bytes(b"x")
    crash = "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)"
    monkeypatch.setattr(gaussforge_formats, "_PROGRAM", crash)
    with refuses(FileFormatError):
        load_gaussians(tmp_path / "a.sog")
    with refuses(ScoupError):
        save_gaussians(tame(3, 1, 3), tmp_path / "b.sog")
    assert not (tmp_path / "b.sog").exists()
    monkeypatch.setattr(gaussforge_formats, "_PROGRAM", "import time; time.sleep(60)")
    monkeypatch.setattr(gaussforge_formats, "_LEAST_SECONDS", 0.5)
    with refuses(FileFormatError):
        load_gaussians(tmp_path / "a.sog")


def test_a_missing_package_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "a.ksplat").write_bytes(b"x")
    monkeypatch.setitem(sys.modules, "gaussforge", None)
    with refuses(ScoupError):
        load_gaussians(tmp_path / "a.ksplat")
    with refuses(ScoupError):
        save_gaussians(tame(3, 1, 3), tmp_path / "b.sog")


def test_harmonics_of_ksplat_stand_in_the_order_of_the_format(tmp_path: Path) -> None:
    """Degree 1 of red, green and blue, then degree 2 of each, as GaussianSplats3D has them; it knows no degree 3."""
    made = tame(1, 3, 3)
    with warns(ScoupWarning):
        save_gaussians(made, tmp_path / "a.ksplat")
    row = np.frombuffer((tmp_path / "a.ksplat").read_bytes()[4096 + 1024 :], "<f4")[11 : 11 + 24]
    expected = [made.sh[0, first:end, channel] for first, end in ((1, 4), (4, 9)) for channel in range(3)]
    np.testing.assert_array_equal(row, torch.cat(expected))
    assert load_gaussians(tmp_path / "a.ksplat").sh[:, 1:].equal(made.sh[:, 1:9])
