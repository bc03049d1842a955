"""The folder for files that can be made again, one per user."""

from __future__ import annotations

import os
import sys
from pathlib import Path


def cache_folder() -> Path | None:
    """Return the folder of SCOUP's cache, which may be missing; None if the user has no home.

    It is the environment variable ``SCOUP_CACHE``, else ``scoup`` in the usual place of the platform: $XDG_CACHE_HOME
    or ~/.cache, ~/Library/Caches on macOS, %LOCALAPPDATA% on Windows.
    """
    if own := os.environ.get("SCOUP_CACHE"):
        return Path(own)
    variable, usual = {
        "darwin": ("", "Library/Caches"),
        "win32": ("LOCALAPPDATA", "AppData/Local"),
    }.get(sys.platform, ("XDG_CACHE_HOME", ".cache"))
    place = os.environ.get(variable, "")
    if os.path.isabs(place):  # XDG: a relative path is ignored
        return Path(place) / "scoup"
    try:
        return Path.home() / usual / "scoup"
    except RuntimeError:
        return None
