"""Fields of other systems answer as their own features do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from foreign_samples import LangSplatAutoencoder, captured, save_langsplatv2
from io_samples import save_checkpoint, some_gaussians
from messages import refuses
from scoup.base import FileFormatError, InputError
from scoup.field import relevancy
from scoup.io import load_gaussians, read_autoencoder, read_langsplat, save_gaussians
from scoup.io.gaussian_features import read_features
from scoup.query import LanguageField
from scoup.uplift import foreign
from scoup.uplift.foreign import field_from_features, field_from_langsplat, langsplat_levels
from support import unit


def queries(dim: int) -> tuple[torch.Tensor, torch.Tensor]:
    random = torch.Generator().manual_seed(9)
    return unit(torch.randn(5, dim, generator=random)), unit(torch.randn(4, dim, generator=random))


def literal_codes(logits: torch.Tensor, k: int) -> torch.Tensor:
    """``softmax_to_topk_soft_code`` of LangSplatV2."""
    values, places = torch.topk(logits.softmax(1), k, dim=1)
    return torch.zeros_like(logits).scatter_(1, places, values / (values.sum(1, keepdim=True) + 1e-10))


def test_langsplatv2_answers_as_its_own_features_do(tmp_path: Path) -> None:
    given = some_gaussians(40, 1)
    paths, features = [], []
    for level in (1, 2, 3):
        path = tmp_path / f"teatime_{level}" / "chkpnt10000.pth"
        logits, books = save_langsplatv2(given, path, seed=level)
        paths.append(path)
        features.append(unit(literal_codes(logits, 4) @ books[0]))
    assert langsplat_levels(paths[1]) == paths
    field = field_from_langsplat(paths)
    assert field.levels == ("s", "m", "l")
    assert field.code_indices.shape == (40, 3, 4)
    wanted, canonical = queries(16)
    found = field.gaussian_relevancy(wanted, canonical)
    for level, rows in enumerate(features):
        expected = relevancy((rows @ wanted.T).T[None], (rows @ canonical.T).T[None])[0]
        assert torch.allclose(found[level], expected, atol=2e-3)  # weights are float16
        assert torch.allclose(field.gaussian_features(level), rows, atol=2e-3)
    field.save(tmp_path / "a.scoup")
    again = LanguageField.load(tmp_path / "a.scoup")
    assert again.gaussian_relevancy(wanted, canonical).equal(found)
    assert again.info.provenance["converted_from"] == "LangSplatV2"


def test_one_level_and_several_codebooks(tmp_path: Path) -> None:
    given = some_gaussians(12, 0)
    path = tmp_path / "room" / "chkpnt30000.pth"
    logits, books = save_langsplatv2(given, path, layers=2)
    assert langsplat_levels(path) == [path]
    field = field_from_langsplat([path], k=3)
    assert field.levels == ("m",)
    assert field.code_indices.shape == (12, 1, 6)
    parts = [literal_codes(logits[:, 8 * n : 8 * n + 8], 3) @ books[n] for n in range(2)]
    assert torch.allclose(field.gaussian_features(0), unit(parts[0] + parts[1]), atol=2e-3)


@pytest.mark.parametrize("layout", ["langsplat", "occam", "feature_3dgs"])
def test_checkpoints_with_a_feature_per_gaussian(tmp_path: Path, layout: str) -> None:
    given, rows = some_gaussians(200, 1), clustered(200, 96)
    network = LangSplatAutoencoder([24, 3], [24, 96], dim=96).eval()
    torch.save(network.state_dict(), tmp_path / "best_ckpt.pth")
    with torch.no_grad():
        codes = network.encode(rows)
        expected = network.decode(codes) if layout == "langsplat" else unit(rows)
    feature = {"langsplat": codes * 3, "occam": rows, "feature_3dgs": rows[:, None]}[layout]
    entries = captured(given)[0]
    rest = entries[9:]
    entries = (*entries[:7], *((*rest, feature) if layout == "feature_3dgs" else (feature, *rest)))
    path = tmp_path / "chkpnt30000.pth"
    torch.save((entries, 30000), path)
    decode = read_autoencoder(tmp_path / "best_ckpt.pth") if layout == "langsplat" else None
    field = field_from_langsplat([path], decode=decode, n_atoms=32)
    assert field.gaussians.fingerprint() == read_langsplat(path).gaussians.fingerprint()
    assert float((field.gaussian_features(0) * expected).sum(1).mean()) > 0.95
    if layout == "langsplat":
        with refuses(FileFormatError):
            field_from_langsplat([path])
    with refuses(FileFormatError):
        load_gaussians(path)


def test_levels_of_different_splats_are_refused(tmp_path: Path) -> None:
    for number in (1, 2, 3):
        save_langsplatv2(some_gaussians(5 + (number == 3), 0), tmp_path / f"a_{number}" / "c.pth")
    with refuses(FileFormatError):
        field_from_langsplat(langsplat_levels(tmp_path / "a_1" / "c.pth"))
    for paths, k in (([tmp_path / "a_1" / "c.pth"], 9), ([], 4)):
        with refuses():
            field_from_langsplat(paths, k=k)


def clustered(count: int, dim: int = 16, kinds: int = 6) -> torch.Tensor:
    random = torch.Generator().manual_seed(3)
    centres = torch.randn(kinds, dim, generator=random)
    rows = centres[torch.randint(kinds, (count,), generator=random)]
    return rows + 0.05 * torch.randn(count, dim, generator=random)


@pytest.mark.parametrize("levels", [None, 3])
def test_features_become_codes_that_answer_alike(levels: int | None) -> None:
    given = some_gaussians(200, 0)
    rows = clustered(200) if levels is None else torch.stack([clustered(200)] * levels, 1)
    rows = rows * torch.rand(200, *[1] * (rows.dim() - 1)) * 50  # only directions count
    field = field_from_features(given, rows.numpy(), n_atoms=12, k=3)
    assert field.levels == (("m",) if levels is None else ("s", "m", "l"))
    assert min(field.info.provenance["mean_cosine"].values()) > 0.99
    wanted, canonical = queries(16)
    known = unit(rows if levels is None else rows[:, 0])
    expected = relevancy((known @ wanted.T).T[None], (known @ canonical.T).T[None])[0]
    assert float((field.gaussian_relevancy(wanted, canonical)[0] - expected).abs().mean()) < 0.05
    again = field_from_features(given, rows, n_atoms=12, k=3)
    assert again.code_indices.equal(field.code_indices)
    assert again.code_weights.equal(field.code_weights)


def test_unknown_rows_have_no_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign, "LEARNED_FROM", 30)
    monkeypatch.setattr(foreign, "ROWS_AT_A_TIME", 16)
    rows = clustered(100)
    rows[3], rows[50], rows[99] = 0, torch.nan, torch.inf
    field = field_from_features(some_gaussians(100, 0), rows, n_atoms=12, k=2)
    assert (~field.coded()).nonzero()[:, 0].tolist() == [3, 50, 99]
    for wrong, levels in ((torch.zeros(100, 8), None), (rows[:99], None), (rows, ("a", "b"))):
        with refuses():
            field_from_features(some_gaussians(100, 0), wrong, levels=levels)


@pytest.mark.parametrize("name", ["a.ply", "ckpt_1_rank0.pt"])
def test_features_of_dropped_rows_are_dropped(tmp_path: Path, name: str) -> None:
    given, rows = some_gaussians(50, 0), clustered(50)
    given.means[5, 0] = torch.nan
    write = save_checkpoint if name.endswith(".pt") else save_gaussians
    write(given, tmp_path / name)
    with pytest.warns(match="dropped 1 of 50"):
        found = load_gaussians(tmp_path / name)
    left = torch.arange(50) != 5
    expected = field_from_features(found, rows[left], n_atoms=12, k=2)
    for features in (rows, rows.numpy(), rows[left]):
        assert field_from_features(found, features, n_atoms=12, k=2).code_weights.equal(expected.code_weights)
    with pytest.raises(InputError):
        field_from_features(found.select(left[1:]), rows)


def test_arrays_are_read_from_files(tmp_path: Path) -> None:
    rows = clustered(9)
    half = rows.half().numpy()
    np.save(tmp_path / "a.npy", rows.numpy())
    np.save(tmp_path / "half.npy", half)
    torch.save(rows, tmp_path / "a.pt")
    for name, expected in (("a.npy", rows.numpy()), ("a.pt", rows.numpy()), ("half.npy", half)):
        found = read_features(tmp_path / name)
        assert found.dtype == expected.dtype
        assert np.array_equal(found, expected)
    assert len(field_from_features(some_gaussians(9, 0), half, n_atoms=8)) == 9
    torch.save({"a": rows}, tmp_path / "dict.pt")
    torch.save(torch.zeros(1).expand(10**9, 3), tmp_path / "large.pt")
    np.save(tmp_path / "whole.npy", np.zeros((4, 4), int))
    np.save(tmp_path / "flat.npy", np.zeros(4))
    (tmp_path / "a.txt").write_text("1 2 3")
    for name in ("dict.pt", "large.pt", "whole.npy", "flat.npy", "a.txt", "none.npy"):
        with refuses(FileFormatError):
            read_features(tmp_path / name)
