"""Small twins, written once."""

from __future__ import annotations

from pathlib import Path

import pytest

from scoup.demo.twins import TwinSize, write_twin

TINY = TwinSize(n_gaussians=4000, width=96, height=72, n_views=6, n_labelled=2)


@pytest.fixture(scope="session")
def twins(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a twin of each data set, named after it; two scenes each. Nobody writes into it."""
    folder = tmp_path_factory.mktemp("twins")
    for name in ("lerf-ovs", "3d-ovs"):
        write_twin(name, folder / name, ("table", "shelves"), TINY)
    half = TwinSize(**{**TINY.__dict__, "label_scale": 0.5})
    write_twin("mipnerf360", folder / "mipnerf360", ("table", "shelves"), half)
    return folder
