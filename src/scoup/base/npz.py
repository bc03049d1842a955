"""Archives of arrays (.npz) whose bytes depend on nothing but the arrays."""

from __future__ import annotations

import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from scoup.base.atomic import atomic_file

if TYPE_CHECKING:
    import numpy as np


def write_npz(
    path: str | Path, arrays: Mapping[str, np.ndarray], overwrite: bool = False, compressed: bool = False
) -> None:
    """Write arrays by their names, atomically."""
    import numpy as np

    # Not numpy.savez: it stamps the time of writing, and the same arrays should give the same bytes.
    with atomic_file(path, overwrite) as stream, zipfile.ZipFile(stream, "w") as archive:
        for name, array in arrays.items():
            entry = zipfile.ZipInfo(f"{name}.npy")
            entry.compress_type = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
            with archive.open(entry, "w", force_zip64=array.nbytes > 1 << 30) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
