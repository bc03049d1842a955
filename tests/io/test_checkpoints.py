"""Checkpoints of gsplat, nerfstudio, LangSplatV2 and LangSplat's autoencoder, in their own layouts."""

from __future__ import annotations

import zipfile
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch

from foreign_samples import LangSplatAutoencoder, save_langsplatv2, save_run, save_splatfacto
from io_samples import save_checkpoint, some_gaussians
from messages import refuses
from scoup.base import FileFormatError, MissingFileError
from scoup.io import load_gaussians, splat_source
from scoup.io.langsplat_checkpoint import read_langsplat
from scoup.io.regions.langsplat_autoencoder import read_autoencoder
from scoup.io.splats.gsplat_checkpoint import latest_ranks, read_gsplat_checkpoint
from scoup.scene import Gaussians


def save_nerfstudio(given: Gaussians, path: Path, older: bool = False) -> None:
    save_run(path.parents[1], "data/kitchen")
    save_splatfacto(some_gaussians(4, 0), path.with_name("step-000009999.ckpt"), older)
    save_splatfacto(given, path, older)


RUN = "kitchen/splatfacto/2026-01-01_000000"
CHECKPOINTS = {
    "gsplat": (save_checkpoint, "ckpts/ckpt_99_rank0.pt", "."),
    "nerfstudio": (save_nerfstudio, f"{RUN}/nerfstudio_models/step-000029999.ckpt", RUN),
    "older": (partial(save_nerfstudio, older=True), f"{RUN}/nerfstudio_models/step-000029999.ckpt", RUN),
    "LangSplatV2": (save_langsplatv2, "chkpnt10000.pth", None),
}  # fmt: skip


@pytest.mark.parametrize("degree", [0, 2, 3])
@pytest.mark.parametrize("name", CHECKPOINTS)
def test_what_trainers_write_is_read(tmp_path: Path, name: str, degree: int) -> None:
    given, (save, file, folder) = some_gaussians(9, degree), CHECKPOINTS[name]
    given.sh.clamp_(-1, 1)
    saved = save(given, tmp_path / file)
    if folder is None:
        read = read_langsplat(tmp_path / file)
        assert np.array_equal(read.values[:, 0], saved[0].numpy())
        assert read.codebooks is not None
        assert np.array_equal(read.codebooks, saved[1].numpy())
        found = [read.gaussians]
    else:
        places = (tmp_path / file, tmp_path / folder)
        found = [load_gaussians(place) for place in places]
        assert {splat_source(place).preset for place in places} == {"gsplat"}
    for each, (part, tensor) in product(found, given.tensors().items()):
        torch.testing.assert_close(each.tensors()[part], tensor, rtol=1e-5, atol=2e-6)
        if part == "means" or (part == "sh" and name in ("gsplat", "LangSplatV2")):
            assert each.tensors()[part].equal(tensor)


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


def test_archives_that_libraries_refuse(tmp_path: Path) -> None:
    """In words that are theirs: an archive of other content, and one in several parts."""
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("hello.txt", "hello")
    locator = b"PK\6\7" + bytes(12) + (2).to_bytes(4, "little")
    for content in ((tmp_path / "a.pt").read_bytes(), locator + b"PK\5\6" + bytes(18)):
        (tmp_path / "a.pt").write_bytes(content)
        with pytest.raises(FileFormatError, match="cannot be loaded"):
            load_gaussians(tmp_path / "a.pt")
