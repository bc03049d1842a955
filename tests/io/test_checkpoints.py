"""Checkpoints of gsplat, nerfstudio, LangSplatV2 and LangSplat's autoencoder, in their own layouts."""

from __future__ import annotations

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch

from foreign_samples import LangSplatAutoencoder, save_langsplatv2
from io_samples import save_checkpoint, some_gaussians
from messages import refuses
from scoup.base.errors import FileFormatError, MissingFileError
from scoup.io import load_gaussians
from scoup.io.langsplat_checkpoint import read_langsplat
from scoup.io.regions.langsplat_autoencoder import read_autoencoder
from scoup.io.splats.gsplat_checkpoint import latest_ranks, read_gsplat_checkpoint


def test_one_file(tmp_path):
    gaussians = some_gaussians(9, degree=2)
    save_checkpoint(gaussians, tmp_path / "ckpt_99_rank0.pt")
    again = read_gsplat_checkpoint(tmp_path / "ckpt_99_rank0.pt")
    torch.testing.assert_close(again.scales, gaussians.scales)
    torch.testing.assert_close(again.opacities, gaussians.opacities)
    torch.testing.assert_close(again.quats, gaussians.quats)
    assert torch.equal(again.sh, gaussians.sh)


def test_all_ranks_of_the_latest_step_in_order(tmp_path):
    for step, rank in ((7, 0), (7, 1), (30, 1), (30, 0), (30, 10)):
        save_checkpoint(
            some_gaussians(3, seed=step + rank), tmp_path / "ckpts" / f"ckpt_{step}_rank{rank}.pt"
        )
    with refuses(MissingFileError):
        read_gsplat_checkpoint(tmp_path)
    (tmp_path / "ckpts" / "ckpt_30_rank10.pt").unlink()
    assert [path.name for path in latest_ranks(tmp_path)] == ["ckpt_30_rank0.pt", "ckpt_30_rank1.pt"]
    again = read_gsplat_checkpoint(tmp_path / "ckpts")
    expected = [some_gaussians(3, seed=30).means, some_gaussians(3, seed=31).means]
    assert torch.equal(again.means, torch.cat(expected))
    (tmp_path / "ckpts" / "ckpt_30_rank1.pt").unlink()
    with refuses(MissingFileError):  # which step 7 has
        read_gsplat_checkpoint(tmp_path)


@pytest.mark.parametrize("degree", [0, 3])
def test_checkpoints_are_read(tmp_path: Path, degree: int) -> None:
    given = some_gaussians(7, degree)
    logits, codebooks = save_langsplatv2(given, tmp_path / "chkpnt10000.pth")
    found = read_langsplat(tmp_path / "chkpnt10000.pth")
    for name in ("scales", "opacities", "quats"):
        torch.testing.assert_close(getattr(found.gaussians, name), getattr(given, name), rtol=1e-5, atol=1e-6)
    assert found.gaussians.sh.equal(given.sh)
    assert np.array_equal(found.values[:, 0], logits.numpy())
    assert found.codebooks is not None
    assert np.array_equal(found.codebooks, codebooks.numpy())


def test_rows_that_are_not_finite_take_their_codes_with_them(tmp_path: Path) -> None:
    given = some_gaussians(7, 0)
    given.means[2] = torch.nan
    logits, _ = save_langsplatv2(given, tmp_path / "a.pth")
    with pytest.warns(match="dropped 1 of 7"):
        found = read_langsplat(tmp_path / "a.pth")
    assert np.array_equal(found.values[:, 0], logits.numpy()[[0, 1, 3, 4, 5, 6]])


def test_the_autoencoder_decodes_as_langsplats_does(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = LangSplatAutoencoder([24, 8, 3], [8, 24, 32], dim=32).eval()
    torch.save(network.state_dict(), tmp_path / "best_ckpt.pth")
    rows = torch.nn.functional.normalize(torch.randn(9, 32), dim=1)
    with torch.no_grad():
        codes = network.encode(rows)
        expected = network.decode(codes)
    codes[4] = 0
    found = read_autoencoder(tmp_path / "best_ckpt.pth")(codes.numpy())
    assert found.dtype == np.float32
    assert not found[4].any()
    known = [0, 1, 2, 3, 5, 6, 7, 8]
    np.testing.assert_allclose(found[known], expected.numpy()[known], atol=1e-6)
    with refuses():
        read_autoencoder(tmp_path / "best_ckpt.pth")(np.zeros((2, 5)))


def several_parts(path: Path) -> None:
    path.write_bytes(b"PK\6\7" + bytes(12) + (2).to_bytes(4, "little") + b"PK\5\6" + bytes(18))


def other_archive(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("hello.txt", "hello")


@pytest.mark.parametrize("write", [several_parts, other_archive])
def test_archives_that_libraries_refuse(tmp_path: Path, write: Callable[[Path], None]) -> None:
    """In words that are theirs."""
    write(tmp_path / "a.pt")
    with pytest.raises(FileFormatError, match="cannot be loaded"):
        load_gaussians(tmp_path / "a.pt")
