"""Names of the files in a folder of region sums."""

from __future__ import annotations

import hashlib

from scoup.base.file_names import slug

ENDING = ".safetensors"
SCENE = "scene"  # stem of the file that is not a view


def view_stem(view_name: str) -> str:
    """Return the stem of a view's file: readable, and unique to this view."""
    return f"view.{slug(view_name)}.{hashlib.sha256(view_name.encode()).hexdigest()[:12]}"


def view_file(view_name: str) -> str:
    """Return the name of a view's file."""
    return view_stem(view_name) + ENDING
