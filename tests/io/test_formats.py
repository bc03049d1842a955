"""The table of splat formats: what holds for all of them, and for the documents that list them."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest
import torch

from foreign_samples import save_run
from io_samples import some_gaussians
from scoup.base import FileFormatError, InputError, MissingFileError, OutputExistsError
from scoup.field.content import TENSORS
from scoup.io import load_gaussians, save_gaussians, splat_source, written_format
from scoup.io.splats.formats import FORMATS, format_of

DOCUMENT = (Path(__file__).parents[2] / "docs" / "formats.md").read_text()
HAVE = importlib.util.find_spec("gaussforge") is not None
ENDINGS = [
    pytest.param(
        ending, marks=pytest.mark.skipif(kind.extra == "splats" and not HAVE, reason="not installed")
    )
    for kind in FORMATS.values()
    if kind.read is not None and kind.write is not None
    for ending in kind.endings
]


@pytest.mark.parametrize("ending", ENDINGS)
def test_what_is_written_is_read(tmp_path: Path, ending: str) -> None:
    gaussians, path = some_gaussians(40, 1), tmp_path / f"a{ending}"
    gaussians.sh.clamp_(-0.9, 0.9)
    save_gaussians(gaussians, path)
    found = load_gaussians(path)
    order = torch.cdist(found.means, gaussians.means).argmin(1)  # .sog sorts
    assert sorted(order.tolist()) == list(range(40))
    torch.testing.assert_close(found.means, gaussians.means[order], atol=0.01, rtol=0)
    torch.testing.assert_close(found.opacities, gaussians.opacities[order], atol=0.1, rtol=0)
    save_gaussians(gaussians, tmp_path / f"b{ending}")
    assert (tmp_path / f"b{ending}").read_bytes() == path.read_bytes()
    with pytest.raises(OutputExistsError):
        save_gaussians(gaussians, path)


@pytest.mark.parametrize("ending", ENDINGS)
def test_axes_can_be_kept(tmp_path: Path, ending: str) -> None:
    gaussians, path = some_gaussians(5), tmp_path / f"a{ending}"
    save_gaussians(gaussians, path, keep_axes=True)
    kept, turned = (load_gaussians(path, keep_axes=keep_axes) for keep_axes in (True, False))
    axis = written_format(path).axis
    signs = torch.tensor([1.0 if axis in (None, name) else -1.0 for name in "xyz"])
    assert turned.means.equal(kept.means * signs)


@pytest.mark.parametrize("ending", ENDINGS)
def test_damaged_files_are_refused_by_name(tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"a{ending}"
    with pytest.raises(MissingFileError, match="there is no such file"):
        load_gaussians(path)
    save_gaussians(some_gaussians(40), path)
    content = path.read_bytes()
    damages = [b"", content[:1], content[: len(content) // 2 - 1]]
    if ending != ".splat":  # without a header, its bytes pass in any order
        damages.append(content[::-1])
    for damaged in damages:
        path.write_bytes(damaged)
        with pytest.raises(FileFormatError, match=f"{re.escape(str(path))}: "):
            load_gaussians(path)


def test_names_decide() -> None:
    kinds = {"a.ply": "Inria PLY", "a.compressed.PLY": "compressed PLY", "a.usdz": "OpenUSD"}
    kinds |= {"step-000000009.ckpt": "nerfstudio checkpoint", "other.ckpt": "gsplat checkpoint"}
    for name, expected in kinds.items():
        kind = format_of(name)
        assert kind is not None
        assert kind.name == expected
    assert format_of("ply") is None
    with pytest.raises(InputError, match=r"cannot write Gaussians as \.pt; use one of \.ply, .*, or a field"):
        written_format("a.pt", "a field")


def test_a_training_decides_the_preset_of_what_it_exported(tmp_path: Path) -> None:
    save_run(tmp_path, "data")
    save_gaussians(some_gaussians(), tmp_path / "splat.ply")
    source = splat_source(tmp_path)
    assert (source.path.name, source.kind.name, source.preset) == ("splat.ply", "Inria PLY", "gsplat")
    assert splat_source(tmp_path / "splat.ply").preset == "inria"


def test_documents_list_all() -> None:
    splats = DOCUMENT.split("## Splats")[1].split("\n## ")[0]
    for kind in FORMATS.values():
        for text in (kind.name, *kind.endings):
            assert text in splats, text
    field = DOCUMENT.split("## The language field")[1].split("\n## ")[0]
    for name in TENSORS:
        assert name in field, name
