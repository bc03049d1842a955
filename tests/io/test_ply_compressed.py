from __future__ import annotations

import numpy as np
import pytest

from io_samples import save_compressed_ply
from scoup.base.errors import FileFormatError
from scoup.io.splats.ply import gaussians_from_table, read_ply, read_ply_table


def test_compressed_files(tmp_path):
    save_compressed_ply(tmp_path / "a.ply", count=300)
    gaussians = read_ply(tmp_path / "a.ply")
    assert gaussians.sh.shape == (300, 4, 3)
    assert gaussians.means.min() >= -1.5
    assert gaussians.means.max() <= 0.5
    assert gaussians.sh[:, 1:].abs().max() == 4
    raw = np.frombuffer((tmp_path / "a.ply").read_bytes()[-300 * 9 :], np.uint8).reshape(300, 9)
    np.testing.assert_allclose(gaussians.sh[:, 2, 1], raw[:, 4] * (8 / 255) - 4, atol=1e-6)
    with pytest.raises(FileFormatError, match=r"compressed PLY.*splat-transform"):
        gaussians_from_table(read_ply_table(tmp_path / "a.ply"))
    whole = (tmp_path / "a.ply").read_bytes()
    (tmp_path / "a.ply").write_bytes(whole.replace(b"element chunk 2", b"element chunk 1"))
    with pytest.raises(FileFormatError, match="has 1 chunks for 300 vertices"):
        read_ply(tmp_path / "a.ply")
    (tmp_path / "a.ply").write_bytes(whole.replace(b"min_scale_y", b"min_scale_q"))
    with pytest.raises(FileFormatError, match="lacks min_scale_x or its like"):
        read_ply(tmp_path / "a.ply")
