"""The folder of the real scenes that some benchmarks measure."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path


def data_folder() -> Path:
    """Return the folder named by SCOUP_TEST_DATA, else ../shared/data."""
    return Path(os.environ.get("SCOUP_TEST_DATA", "../shared/data"))


def make_features(kitchen: Path, folder: Path) -> Path:
    """Write the kitchen's simulated region features below ``folder``, by its own script; returns where."""
    features = folder / "language_features"
    script = kitchen / "make_langsplat_features.py"
    command = [sys.executable, str(script), str(kitchen), "--out", str(features)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return features
