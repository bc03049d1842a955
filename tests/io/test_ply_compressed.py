"""Compressed PLY, read and written."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given as given_any
from hypothesis import settings
from hypothesis import strategies as st

from io_samples import angles, save_compressed_ply, some_gaussians
from scoup.base import FileFormatError, InputError
from scoup.io import save_gaussians
from scoup.io.splats.ply import gaussians_from_table, read_ply, read_ply_table
from scoup.io.splats.ply_compressed import write_compressed_ply
from scoup.scene import SH_C0, Gaussians
from support import examples


def test_compressed_files(tmp_path):
    save_compressed_ply(tmp_path / "a.ply", count=300)
    gaussians = read_ply(tmp_path / "a.ply")
    assert gaussians.sh.shape == (300, 4, 3)
    assert gaussians.means.min() >= -1.5
    assert gaussians.means.max() <= 0.5
    assert gaussians.sh[:, 1:].abs().max() == 4
    raw = np.frombuffer((tmp_path / "a.ply").read_bytes()[-300 * 9 :], np.uint8).reshape(300, 9)
    inner = (raw[:, 4] > 0) & (raw[:, 4] < 255)
    green = gaussians.sh[:, 2, 1].numpy()
    np.testing.assert_allclose(green[inner], (raw[inner, 4] + 0.5) / 32 - 4, atol=1e-6)
    assert set(green[~inner].tolist()) <= {-4.0, 4.0}
    with pytest.raises(FileFormatError, match=r"compressed PLY.*scoup convert"):
        gaussians_from_table(read_ply_table(tmp_path / "a.ply"))
    whole = (tmp_path / "a.ply").read_bytes()
    for there, other, said in (
        (b"element chunk 2", b"element chunk 1", "has 1 chunks for 300 vertices"),
        (b"min_scale_y", b"min_scale_q", "lacks min_scale_x or a similar property"),
    ):
        (tmp_path / "a.ply").write_bytes(whole.replace(there, other))
        with pytest.raises(FileFormatError, match=said):
            read_ply(tmp_path / "a.ply")


def spread(gaussians: Gaussians) -> tuple[np.ndarray, ...]:
    """The extent of means, log scales and colours of each row's block, which bound the rounding."""
    block = np.arange(len(gaussians)) // 256
    extents = []
    for values in (gaussians.means, gaussians.scales.log(), gaussians.sh[:, 0] * SH_C0 + 0.5):
        rows = values.double().numpy()
        ranges = [np.ptp(rows[block == number], axis=0) for number in range(block[-1] + 1)]
        extents.append(np.stack(ranges)[block])
    return tuple(extents)


@settings(max_examples=examples(30))
@given_any(st.integers(1, 600), st.integers(0, 3), st.integers(0, 2**31))
def test_round_trips_round_as_stated(tmp_path_factory, count, degree, seed):
    path = tmp_path_factory.mktemp("compressed") / "a.compressed.ply"
    given = some_gaussians(count, degree, seed)
    given = replace(given, sh=given.sh.clamp(-3.9, 3.9))
    write_compressed_ply(given, path)
    found = read_ply(path)
    places, sizes, colors = spread(given)
    steps = np.array([2047, 1023, 2047])
    moved, grown = (found.means - given.means).double(), (found.scales.log() - given.scales.log()).double()
    for change, extent in ((moved, places), (grown, sizes)):
        assert (np.abs(change.numpy()) <= 0.5 / steps * extent + 1e-5).all()
    difference = np.abs((found.sh[:, 0] - given.sh[:, 0]).double().numpy()) * SH_C0
    assert (difference <= 0.5 / 255 * colors + 1e-5).all()
    assert float((found.opacities - given.opacities).abs().max()) <= 0.5 / 255 + 1e-6
    if degree:
        assert float((found.sh[:, 1:] - given.sh[:, 1:]).abs().max()) <= 1 / 32 + 1e-5
    assert float(angles(found.quats, given.quats).max()) <= 0.25
    write_compressed_ply(found, path, overwrite=True)
    again = read_ply(path)
    assert torch.allclose(again.means, found.means, atol=1e-5)
    assert again.opacities.equal(found.opacities)


def test_an_independent_library_reads_what_is_written(tmp_path):
    gaussforge = pytest.importorskip("gaussforge", reason="gaussforge is not installed")
    given = some_gaussians(700, 2)
    write_compressed_ply(given, tmp_path / "a.compressed.ply")
    library = gaussforge.GaussForge()
    content = (tmp_path / "a.compressed.ply").read_bytes()
    (tmp_path / "b.ply").write_bytes(library.convert(content, "compressed.ply", "ply")["data"])
    ours, theirs = read_ply(tmp_path / "a.compressed.ply"), read_ply(tmp_path / "b.ply")
    for name in ("means", "scales", "sh"):
        assert torch.allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-4, atol=1e-4)
    assert torch.allclose(ours.opacities, theirs.opacities, atol=2e-3)  # it keeps them away from 0 and 1
    assert float((ours.quats * theirs.quats).sum(1).abs().min()) > 0.999999


def test_ugly_values(tmp_path):
    given = some_gaussians(3, 0)
    flat = replace(given, scales=torch.zeros(3, 3), opacities=torch.tensor([torch.inf, 0.0, -1.0]))
    write_compressed_ply(flat, tmp_path / "a.ply")
    found = read_ply(tmp_path / "a.ply")
    assert found.opacities.tolist() == [1.0, 0.0, 0.0]
    assert float(found.scales.max()) < 1e-8
    with pytest.raises(InputError, match="not finite"):
        write_compressed_ply(replace(given, opacities=torch.full((3,), torch.nan)), tmp_path / "b.ply")
    save_gaussians(given, tmp_path / "c.compressed.ply")
    assert b"packed_position" in (tmp_path / "c.compressed.ply").read_bytes()[:900]
    assert not (tmp_path / "b.ply").exists()
    write_compressed_ply(given.select([]), tmp_path / "d.ply")
    assert len(read_ply(tmp_path / "d.ply")) == 0
