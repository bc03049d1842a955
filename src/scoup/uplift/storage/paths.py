"""Names of the files of region sums, and of their folders beside a field."""

from __future__ import annotations

import hashlib
from pathlib import Path

from scoup.base.file_names import slug
from scoup.base.shares import Share

ENDING = ".safetensors"
SCENE, CODES, INPUTS = "scene", "codes", "inputs"  # stems of the files that are not views


def sums_path(field: Path) -> Path:
    """Return the folder of a field's region sums, beside it."""
    return field.with_name(field.name + ".sums")


def shard_path(field: Path, share: Share) -> Path:
    """Return the folder of a shard of a field's views, beside it."""
    return field.with_name(f"{field.name}.{share}.sums")


def partial_path(field: Path) -> Path:
    """Return the folder where a build keeps its work until the field is written."""
    return field.with_name(f"{field.name}.partial")


def view_stem(view_name: str) -> str:
    """Return the stem of a view's file: readable, and unique to this view."""
    return f"view.{slug(view_name)}.{hashlib.sha256(view_name.encode()).hexdigest()[:12]}"


def view_file(view_name: str) -> str:
    """Return the name of a view's file."""
    return view_stem(view_name) + ENDING


def folder_bytes(path: Path) -> int:
    """Return the size of kept sums on disk."""
    return sum(file.stat().st_size for file in path.glob(f"[!.]*{ENDING}"))
