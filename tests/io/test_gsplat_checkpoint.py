from __future__ import annotations

import pickle
import zipfile

import pytest
import torch

from io_samples import save_checkpoint, some_gaussians
from scoup.base import FileFormatError, MissingFileError
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
    with pytest.raises(MissingFileError, match="step 30 lacks rank 2, 3, 4, 5, 6, 7, 8, 9 of 11"):
        read_gsplat_checkpoint(tmp_path)
    (tmp_path / "ckpts" / "ckpt_30_rank10.pt").unlink()
    assert [path.name for path in latest_ranks(tmp_path)] == ["ckpt_30_rank0.pt", "ckpt_30_rank1.pt"]
    again = read_gsplat_checkpoint(tmp_path / "ckpts")
    expected = [some_gaussians(3, seed=30).means, some_gaussians(3, seed=31).means]
    assert torch.equal(again.means, torch.cat(expected))
    (tmp_path / "ckpts" / "ckpt_30_rank1.pt").unlink()
    with pytest.raises(MissingFileError, match="lacks rank 1 of 2"):  # which step 7 has
        read_gsplat_checkpoint(tmp_path)


class Sneaky:
    def __reduce__(self):
        return print, ("executed",)


def test_foreign_contents(tmp_path, capsys):
    path = tmp_path / "a.pt"
    contents = [{"model": 1}, [1, 2], {"splats": 3}, {"splats": {"means": torch.zeros(2, 3)}}]
    for content, said in (
        *((content, r"a\.pt") for content in contents),
        ({"splats": Sneaky()}, "contains Python objects other than tensors"),
    ):
        torch.save(content, path)
        with pytest.raises(FileFormatError, match=said):
            read_gsplat_checkpoint(path)
    assert "executed" not in capsys.readouterr().out
    path.write_bytes(pickle.dumps({"splats": 1}))
    with pytest.raises(FileFormatError, match="bare Python pickle"):
        read_gsplat_checkpoint(path)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("hello.txt", "hello")
    with pytest.raises(FileFormatError, match="cannot be loaded"):
        read_gsplat_checkpoint(path)


@pytest.mark.parametrize(("changes", "said"), [
    ({"quats": torch.zeros(4, 3)}, r"quats is torch.float32 \[4, 3\], expected floats \[4, 4\]"),
    ({"scales": torch.zeros(3, 3)}, "scales"),
    ({"means": torch.zeros(4, 3, dtype=torch.int64)}, "means"),
    ({"means": torch.zeros(1).expand(10**9, 3), "quats": torch.zeros(1).expand(10**9, 4)}, "means"),
    ({"shN": torch.zeros(4, 4, 3)}, "no whole SH degree"),
], ids=["columns", "rows", "integers", "claimed", "degree"])  # fmt: skip
def test_wrong_shapes_and_claimed_sizes(tmp_path, changes, said):
    path = tmp_path / "a.pt"
    save_checkpoint(some_gaussians(4), path)
    content = torch.load(path, weights_only=True)
    content["splats"].update(changes)
    torch.save(content, path)
    with pytest.raises(FileFormatError, match=said):
        read_gsplat_checkpoint(path)


def with_pickle(path, content):
    """A checkpoint whose pickle is another."""
    torch.save({"a": torch.zeros(4)}, path.with_suffix(".valid"))
    with zipfile.ZipFile(path.with_suffix(".valid")) as valid, zipfile.ZipFile(path, "w") as made:
        for entry in valid.infolist():
            pickled = entry.filename.endswith("data.pkl")
            made.writestr(entry.filename, content if pickled else valid.read(entry))


@pytest.mark.parametrize(
    "name",
    ["builtins\nbytearray", "torch\nFloatTensor", "torch\nTensor", "torch.storage\nUntypedStorage",
     "torch.sparse\nFloatTensor"],
)  # fmt: skip
def test_pickles_that_ask_for_any_amount_of_memory(tmp_path, name):
    size = (10**10).to_bytes(5, "little")
    with_pickle(tmp_path / "a.pt", b"\x80\x02c" + name.encode() + b"\n\x8a\x05" + size + b"\x85R.")
    with pytest.raises(FileFormatError, match=r"makes a .* of its own"):
        read_gsplat_checkpoint(tmp_path / "a.pt")


def test_an_archive_in_several_parts(tmp_path):
    locator = b"PK\6\7" + bytes(12) + (2).to_bytes(4, "little")
    (tmp_path / "a.pt").write_bytes(locator + b"PK\5\6" + bytes(18))
    with pytest.raises(FileFormatError, match="cannot be loaded"):
        read_gsplat_checkpoint(tmp_path / "a.pt")


def test_an_entry_that_claims_more_bytes_than_there_are(tmp_path):
    with_pickle(tmp_path / "a.pt", b"\x80\x02}.")
    content = bytearray((tmp_path / "a.pt").read_bytes())
    entry = content.index(b"PK\1\2")
    while entry >= 0:
        content[entry + 20 : entry + 24] = (2**31 - 1).to_bytes(4, "little")  # packed; unpacked is as before
        entry = content.find(b"PK\1\2", entry + 1)
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(FileFormatError, match="unpacks to more than its size"):
        read_gsplat_checkpoint(tmp_path / "a.pt")
