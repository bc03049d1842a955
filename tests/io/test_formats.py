"""The table of splat formats: each is read as it was written, within the error that is stated here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given as given_any
from hypothesis import settings
from hypothesis import strategies as st
from splat_damages import ENDINGS

from gltf_samples import check_rules
from io_samples import angles, save_spz, some_gaussians, tame
from messages import refuses, warns
from scoup.base import OutputExistsError, ScoupWarning
from scoup.field.checks import TENSORS
from scoup.io import load_gaussians, save_gaussians, written_format
from scoup.io.splats.activation import opacities_from_logits, scales_from_logs
from scoup.io.splats.formats import FORMATS, format_of
from scoup.io.splats.spz import MOST_BITS
from scoup.scene import SH_C0, Gaussians
from support import examples

DOCUMENT = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()

BYTE = 0.5 / 255 + 1e-6
DEGREES = 0.28  # three components to half a step of 0.7 / 511, and the largest, at least 0.5, that follows from them


@dataclass(frozen=True)
class Rounding:
    """How far the values of a format may be from those that were written."""

    means: Callable[[Gaussians], Any] | float
    logs: Callable[[Gaussians], Any] | float  # of scales
    colors: Callable[[Gaussians], Any] | float  # of the harmonics of degree 0
    sh: tuple[float, float] = (0.0, 0.0)  # of degree 1, and of higher ones
    degrees: float = 0.0
    opacities: float = BYTE
    most_degree: int = 3
    most_color: float = 3.0
    most_sh: float = 0.9


def of_blocks(
    values: Callable[[Gaussians], torch.Tensor], steps: list[int]
) -> Callable[[Gaussians], np.ndarray]:
    """Half a step of the extent of each row's block, and what float32 rounds."""

    def bound(gaussians: Gaussians) -> np.ndarray:
        rows = values(gaussians).double().numpy()
        blocks = [rows[start : start + 256] for start in range(0, len(rows), 256)]
        extents = np.concatenate([np.broadcast_to(np.ptp(block, axis=0), block.shape) for block in blocks])
        return 0.5 / np.array(steps) * extents + 1e-5 + 1e-6 * np.abs(rows).max()

    return bound


def of_fractions(gaussians: Gaussians) -> float:
    """Half a step of .spz, whose numbers have as many bits of fractions as 24 bits leave them."""
    largest, bits = float(gaussians.means.abs().max()), MOST_BITS
    while largest * 2**bits > 2**23 - 1:
        bits -= 1
    return 0.5 * 2.0**-bits + 1e-6 * largest


def of_halves(gaussians: Gaussians) -> float:
    return float(gaussians.means.abs().max()) * (2**-11 + 1e-6)


SPZ = Rounding(
    of_fractions,
    0.5 / 16 + 1e-5,
    0.5 / 255 / 0.15 + 1e-5,
    (4 / 128 + 1 / 256 + 1e-6, 8 / 128 + 1 / 256 + 1e-6),
    DEGREES,
)
ROUNDINGS = {
    ".compressed.ply": Rounding(
        of_blocks(lambda some: some.means, [2047, 1023, 2047]),
        of_blocks(lambda some: some.scales.log(), [2047, 1023, 2047]),
        of_blocks(lambda some: some.sh[:, 0] , [255, 255, 255]),
        (1 / 32 + 1e-5, 1 / 32 + 1e-5), DEGREES, most_sh=3.9),
    ".splat": Rounding(0.0, 0.0, 0.5 / 255 / SH_C0 + 1e-5, degrees=1.6, most_degree=0, most_color=1.7),
    ".spz": SPZ, "4.spz": replace(SPZ, most_degree=4), "2.spz": replace(SPZ, degrees=13.0),
    "1.spz": replace(SPZ, means=of_halves, degrees=13.0),
    ".ksplat": Rounding(
        0.0, 1e-5, 1 / 255 / 0.28 + 1e-4, (1e-5, 1e-5), 0.17, 2 * BYTE, most_degree=2, most_color=1.0),
    ".sog": Rounding(0.01, 0.1, 0.1, (0.1, 0.1), 5.0, 0.1),
}  # fmt: skip
BIT_BY_BIT = (".ply", ".glb", ".gltf")
ROUNDINGS |= dict.fromkeys(BIT_BY_BIT, Rounding(0.0, 1e-6, 0.0, opacities=1e-6, degrees=0.1))
QUICK = [name for name in ROUNDINGS if name not in (".ksplat", ".sog")]  # these start a process for each file


def check_rounding(given: Gaussians, found: Gaussians, rounding: Rounding) -> None:
    def most(difference: torch.Tensor, bound: Callable[[Gaussians], Any] | float) -> bool:
        return bool((difference.abs().double().numpy() <= (bound(given) if callable(bound) else bound)).all())

    assert found.sh_degree == min(given.sh_degree, rounding.most_degree)
    assert most(found.means - given.means, rounding.means)
    assert most(found.scales.log() - given.scales.log(), rounding.logs)
    assert most(found.opacities - given.opacities, rounding.opacities)
    assert most(found.sh[:, 0] - given.sh[:, 0], rounding.colors)
    assert float(angles(found.quats, given.quats).max()) <= rounding.degrees
    rest = found.sh[:, 1:] - given.sh[:, 1 : found.sh.shape[1]]
    assert most(rest[:, :3], rounding.sh[0])
    assert most(rest[:, 3:], rounding.sh[1])


def given_to(rounding: Rounding, count: int, seed: int, largest: float, degree: int = 3) -> Gaussians:
    """Gaussians within the ranges of a format."""
    made = tame(count, min(degree, rounding.most_degree), seed, largest, rounding.most_sh)
    made.sh[:, 0] = made.sh[:, 0].clamp(-rounding.most_color, rounding.most_color)
    return made


def written_and_read(given: Gaussians, path: Path, version: int = 0) -> Gaussians:
    """By the entry of the table, which refuses no place that is far from the origin."""
    kind = written_format(path)
    assert kind.write is not None
    assert kind.read is not None
    if version:
        save_spz(given, path, version)
    else:
        kind.write(given, path, True)
    return kind.read(path)


@pytest.mark.parametrize("name", QUICK)
@settings(max_examples=examples(40))
@given_any(
    count=st.integers(1, 600), degree=st.integers(0, 4), seed=st.integers(0, 2**31),
    largest=st.sampled_from([0.5, 127.0, 60000.0]),
)  # fmt: skip
def test_what_is_written_is_read_within_the_stated_error(
    tmp_path_factory, name, count, degree, seed, largest
) -> None:
    path, rounding = tmp_path_factory.mktemp("splats") / f"a{name}", ROUNDINGS[name]
    given = given_to(rounding, count, seed, largest, degree)
    version = int(name[0]) if name[0].isdigit() else 0
    found = written_and_read(given, path, version)
    check_rounding(given, found, rounding)
    # What was rounded once is not rounded again.
    again, share = (
        written_and_read(found, path, version if version > 2 else 0),
        1e-4 if version == 1 else 1e-6,
    )
    assert float((again.means - found.means).abs().max()) <= share * largest + 1e-5
    assert again.opacities.equal(found.opacities)
    torch.testing.assert_close(again.sh, found.sh, rtol=1e-5, atol=1e-5)


NUMBERS = st.floats(-(2.0**99), 2.0**99, width=32)
LOGS = st.floats(-68, 68, width=32) | st.just(-np.inf)


@pytest.mark.parametrize("ending", BIT_BY_BIT)
@settings(max_examples=examples(60))
@given_any(data=st.data(), count=st.integers(1, 5), degree=st.integers(0, 3))
def test_ugly_values_survive_bit_by_bit(tmp_path_factory, ending, data, count, degree) -> None:
    def draw(width: int, values: st.SearchStrategy[float]) -> np.ndarray:
        size = count * width
        drawn = data.draw(st.lists(values, min_size=size, max_size=size))
        return np.array(drawn, np.float32).reshape(count, width)

    quats = draw(4, st.floats(-1, 1, width=32)).astype(np.float64) + [2, 0, 0, 0]
    arrays = (
        draw(3, NUMBERS), quats / np.linalg.norm(quats, axis=1, keepdims=True), scales_from_logs(draw(3, LOGS)),
        opacities_from_logits(draw(1, LOGS | st.just(np.inf))[:, 0]),
        draw(3 * (degree + 1) ** 2, NUMBERS).reshape(count, -1, 3),
    )  # fmt: skip
    given = Gaussians(*(torch.from_numpy(array.astype(np.float32)) for array in arrays))
    path = tmp_path_factory.mktemp("splats") / f"a{ending}"
    found = written_and_read(given, path)
    if ending != ".ply":
        check_rules(path)
    for name, tensor in given.tensors().items():
        assert torch.equal(tensor.view(torch.int32), found.tensors()[name].view(torch.int32)), name
    assert found.fingerprint() == given.fingerprint()


@pytest.mark.parametrize("ending", ENDINGS)
def test_files_of_every_format(tmp_path: Path, ending: str) -> None:
    """They are alike each time, not replaced, and their axes can be kept."""
    path, rounding = tmp_path / f"a{ending}", ROUNDINGS[ending]
    given = given_to(rounding, 300, 3, 10.0)
    save_gaussians(given, path)
    found = load_gaussians(path)
    order = torch.cdist(found.means, given.means).argmin(1)
    assert sorted(order.tolist()) == list(range(300))
    assert (order.tolist() == list(range(300))) == (ending != ".sog")  # which sorts
    check_rounding(given.select(order), found, rounding)
    # Also the order is the same each time, so that a field built on the file fits it.
    assert load_gaussians(path).fingerprint() == found.fingerprint()
    save_gaussians(given, tmp_path / f"b{ending}")
    assert (tmp_path / f"b{ending}").read_bytes() == path.read_bytes()
    with pytest.raises(OutputExistsError):
        save_gaussians(given, path)
    save_gaussians(given, path, overwrite=True, keep_axes=True)
    kept, turned = (load_gaussians(path, keep_axes=keep_axes) for keep_axes in (True, False))
    axis = written_format(path).axis
    assert turned.means.equal(
        kept.means * torch.tensor([1.0 if axis in (None, name) else -1.0 for name in "xyz"])
    )
    assert torch.cdist(kept.means, given.means).amin(1).max() < 0.1


def test_names_decide() -> None:
    kinds = {"a.ply": "Inria PLY", "a.compressed.PLY": "compressed PLY", "a.usdz": "OpenUSD"}
    kinds |= {"step-000000009.ckpt": "nerfstudio checkpoint", "other.ckpt": "gsplat checkpoint"}
    for name, expected in kinds.items():
        kind = format_of(name)
        assert kind is not None
        assert kind.name == expected
    assert format_of("ply") is None
    with refuses():
        written_format("a.pt", "a field")


def test_documents_list_all() -> None:
    splats = DOCUMENT.split("## Splats")[1].split("\n## ")[0]
    for kind in FORMATS.values():
        for text in (kind.name, *kind.endings):
            assert text in splats, text
    field = DOCUMENT.split("## The language field")[1].split("\n## ")[0]
    for name in TENSORS:
        assert name in field, name


@pytest.mark.parametrize("ending", [".compressed.ply", ".spz", ".glb", ".usdc"])
def test_values_that_a_format_has_no_place_for(tmp_path: Path, ending: str) -> None:
    """What is beyond its range is brought into it; what is not finite is refused."""
    if ending == ".usdc":
        pytest.importorskip("pxr", reason="usd-core is not installed")
    given, path = some_gaussians(5, 0), tmp_path / f"a{ending}"
    opacities = torch.tensor([torch.inf, 0.0, -1.0, 1.5, 1.0])
    quats = given.quats * torch.tensor([1, 3, 1, 1, 0])[:, None]
    save_gaussians(replace(given, scales=-given.scales, opacities=opacities, quats=quats), path)
    if ending == ".glb":
        check_rules(path)
    if ending != ".usdc":  # which is not read
        found = load_gaussians(path)
        assert found.opacities.tolist() == [1.0, 0.0, 0.0, 1.0, 1.0]
        torch.testing.assert_close(found.scales.log(), given.scales.log(), atol=0.04, rtol=0)
        assert float(angles(found.quats[:4], given.quats[:4]).max()) < DEGREES
        assert float(angles(found.quats[4:], torch.tensor([[1.0, 0, 0, 0]])).max()) < DEGREES
    if ending in (".glb", ".usdc"):
        with refuses():
            save_gaussians(given.select([]), tmp_path / f"b{ending}")
    refused = [(name, torch.nan) for name in ("means", "opacities", "quats")] + [("sh", torch.inf)]
    for name, value in refused:
        spoiled = getattr(given, name).clone()
        spoiled.view(-1)[0] = value
        with refuses():
            save_gaussians(replace(given, **{name: spoiled}), tmp_path / f"b{ending}")
    assert not (tmp_path / f"b{ending}").exists()


def test_degree_4_is_cut_to_3(tmp_path: Path) -> None:
    given = tame(3, 4, 3)
    with warns(ScoupWarning):
        save_gaussians(given, tmp_path / "a.glb")
    assert torch.equal(load_gaussians(tmp_path / "a.glb").sh[:, 1:], given.sh[:, 1:16])
