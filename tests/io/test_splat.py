from __future__ import annotations

import struct

import numpy as np
import pytest
import torch

from io_samples import same_gaussians, some_gaussians
from scoup.base import FileFormatError, ScoupWarning
from scoup.io.splats.splat import read_splat, write_splat


def record(
    center=(1.0, 2.0, 3.0), scale=(0.1, 0.2, 0.3), color=(255, 128, 0, 51), rotation=(255, 128, 128, 128)
):
    return struct.pack("<6f8B", *center, *scale, *color, *rotation)


def test_fields(tmp_path):
    (tmp_path / "a.splat").write_bytes(record() + record(rotation=(192, 192, 128, 128)))
    gaussians = read_splat(tmp_path / "a.splat")
    assert gaussians.means[0].tolist() == [1, 2, 3]
    np.testing.assert_allclose(gaussians.scales[0], [0.1, 0.2, 0.3], rtol=1e-6)
    assert gaussians.opacities[0].item() == np.float32(0.2)
    np.testing.assert_allclose(gaussians.sh[0, 0] * 0.28209479 + 0.5, [1, 128 / 255, 0], atol=1e-6)
    np.testing.assert_allclose(gaussians.quats, [[1, 0, 0, 0], [0.5**0.5, 0.5**0.5, 0, 0]], atol=1e-6)
    assert gaussians.sh_degree == 0


def test_round_trip_is_within_a_byte_and_stable(tmp_path):
    gaussians = some_gaussians(200, degree=0)
    write_splat(gaussians, tmp_path / "a.splat")
    first = read_splat(tmp_path / "a.splat")
    assert torch.equal(first.means, gaussians.means)
    assert torch.equal(first.scales, gaussians.scales)
    torch.testing.assert_close(first.opacities, gaussians.opacities, atol=0.5 / 255 + 1e-6, rtol=0)
    assert ((first.quats * gaussians.quats).sum(1) > 0.9999).all()
    write_splat(first, tmp_path / "b.splat")
    second = read_splat(tmp_path / "b.splat")
    assert torch.equal(first.opacities, second.opacities)
    assert torch.equal(first.sh, second.sh)


def test_rows_without_a_rotation_are_dropped(tmp_path):
    nan = record(center=(float("nan"), 0, 0))
    (tmp_path / "a.splat").write_bytes(
        record() + record(rotation=(128,) * 4) + nan + record(scale=(-0.1, 0.2, 0.3))
    )
    with pytest.warns(ScoupWarning, match="dropped 2 of 4"):
        gaussians = read_splat(tmp_path / "a.splat")
    assert gaussians.scales[1, 0] > 0
    assert same_gaussians(gaussians.select(torch.tensor([0])), gaussians.select(torch.tensor([1])))


KSPLAT = struct.pack("<2B2x4IH", 0, 1, 1, 0, 0, 64, 0)  # as gaussforge writes it


@pytest.mark.parametrize(
    ("start", "kind"),
    [
        (KSPLAT, r"\.ksplat"), (b"\x1f\x8b\x08\0", "gzip"), (b"PK\x03\x04", "zip"), (b"NGSP\4\0\0\0", r"\.spz"),
        (b"ply\nformat binary_little_endian 1.0\n", "PLY"), (b"glTF\2\0\0\0", r"\.glb"),
        (b"\xef\xbb\xbf\n<!DOCTYPE html>" + b" " * 99, "a web page"), (b'{"a": 1}' + b" " * 88, "JSON"),
        (b"404: Not Found\n" + b" " * 81, "text"),
    ],
)  # fmt: skip
def test_files_of_another_kind_are_named(tmp_path, start, kind):
    content = start + np.random.default_rng(0).bytes(-len(start) % 32 + 64 * (len(start) < 60))
    (tmp_path / "a.splat").write_bytes(content)
    with pytest.raises(FileFormatError, match=rf"not a \.splat file; its content is {kind}"):
        read_splat(tmp_path / "a.splat")


def test_values_beyond_any_scene_are_refused(tmp_path):
    (tmp_path / "a.splat").write_bytes(record() * 20 + record(center=(2e9, 0, 0)))
    assert len(read_splat(tmp_path / "a.splat")) == 21
    (tmp_path / "a.splat").write_bytes(record() * 9 + record(scale=(0.1, 2e9, 0.1)))
    with pytest.raises(FileFormatError, match=r"not a \.splat file: 1 of 10 rows have values beyond"):
        read_splat(tmp_path / "a.splat")


def test_wrong_sizes(tmp_path):
    for content, said in ((record()[:-1], "31 bytes, which is not a multiple of 32"), (b"", "is empty")):
        (tmp_path / "a.splat").write_bytes(content)
        with pytest.raises(FileFormatError, match=said):
            read_splat(tmp_path / "a.splat")
