"""Large arrays in temporary files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from scoup.base.errors import WriteError
from scoup.base.scratch import scratch_array


def test_they_are_zeros_that_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    array = scratch_array((1000, 3), np.float32)
    assert not array.any()
    array[:] = np.arange(3000).reshape(1000, 3)
    tensor = torch.from_numpy(array)
    del array
    assert torch.equal(tensor, torch.arange(3000, dtype=torch.float32).reshape(1000, 3))
    assert not list(tmp_path.iterdir())  # they have no name
    assert scratch_array((0, 3), np.float32).shape == (0, 3)


def test_there_is_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "gone"))
    with pytest.raises(WriteError, match=r"gone.*TMPDIR"):
        scratch_array((1,), np.float32)
