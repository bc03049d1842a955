"""Checkpoints of LangSplatV2 and LangSplat's autoencoder, written by those systems' own layout."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import nn

from foreign_samples import LangSplatAutoencoder, captured, save_langsplatv2
from io_samples import some_gaussians
from scoup.base import FileFormatError, InputError
from scoup.io.langsplat_checkpoint import read_langsplat
from scoup.io.regions.langsplat_autoencoder import read_autoencoder


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


class Runs:
    def __reduce__(self) -> Any:
        return print, ("this was run",)


def changed(place: int, value: Any) -> Callable[[list[Any]], list[Any]]:
    return lambda entries: [*entries[:place], value, *entries[place + 1 :]]


@pytest.mark.parametrize(("change", "said"), [
    (lambda entries: entries[:7] + entries[9:], "without language features"),
    (lambda entries: entries[:5], "no captured Gaussians"),
    (changed(1, torch.zeros(6, 3)), "features_dc is"),
    (changed(7, torch.zeros(7, 9)), "9 logits a Gaussian for 1 codebooks of 8"),
    (changed(8, torch.zeros(8, 16)), "codebooks is"),
    (changed(8, torch.full((1, 8, 16), torch.nan)), "not finite"),
    (changed(1, torch.zeros(1, 1).expand(10**9, 3)), "xyz is"),
    (changed(4, "scales"), "scaling is str"),
    (changed(13, Runs()), "objects other than tensors"),
])  # fmt: skip
def test_other_checkpoints_are_refused(
    tmp_path: Path, change: Any, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    entries = list(captured(some_gaussians(7, 1))[0])
    torch.save((tuple(change(entries)), 10000), tmp_path / "a.pth")
    with pytest.raises(FileFormatError, match=said) as error:
        read_langsplat(tmp_path / "a.pth")
    assert "\n" not in str(error.value)
    assert "this was run" not in capsys.readouterr().out


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
    with pytest.raises(InputError, match="decodes rows of 3 numbers, but the regions have 5"):
        read_autoencoder(tmp_path / "best_ckpt.pth")(np.zeros((2, 5)))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"encoder.0.weight": torch.zeros(3, 3)}, "no layers of a decoder"),
        ({"decoder.0.weight": torch.zeros(3, 3)}, "decoder.0.bias is NoneType"),
        ({"decoder.0.weight": torch.zeros(4, 3), "decoder.0.bias": torch.zeros(4),
          "decoder.2.weight": torch.zeros(5, 9), "decoder.2.bias": torch.zeros(5)}, "takes 9 numbers"),
        ([1, 2], "no layers of a decoder"),
        (nn.Linear(2, 2), "objects other than tensors"),
    ],
)  # fmt: skip
def test_other_networks_are_refused(tmp_path: Path, content: Any, said: str) -> None:
    torch.save(content, tmp_path / "a.pth")
    with pytest.raises(FileFormatError, match=said):
        read_autoencoder(tmp_path / "a.pth")
