"""The folder of the real scenes that some benchmarks measure."""

from __future__ import annotations

import os
from pathlib import Path


def data_folder() -> Path:
    """Return the folder named by SCOUP_TEST_DATA, else ../shared/data."""
    return Path(os.environ.get("SCOUP_TEST_DATA", "../shared/data"))
