"""scoup info: what is in a file or folder."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from scoup.base import MissingFileError, ScoupWarning
from scoup.cli.console import Console, command
from scoup.cli.options import Common, arg


@dataclass(frozen=True, kw_only=True)
class Info:
    """Show what is in a file or folder: a field, region sums, a splat, cameras, a scene, region features, a word
    table."""

    path: Annotated[tyro.conf.Positional[Path], arg(metavar="PATH")]
    """A .scoup, .npz, .json or .safetensors file, a splat (.ply, .spz, .glb, .pt and more), or a folder."""
    common: Common = Common()

    def run(self, console: Console) -> None:
        if not self.path.exists():
            raise MissingFileError(self.path, "there is no such file or folder", "check the path")
        kinds = {".scoup": _field, ".npz": _word_table, ".safetensors": _word_table}
        suffix = "" if self.path.is_dir() else self.path.suffix.lower()
        # Others are folders, splats, cameras or word tables in JSON.
        record = kinds.get(suffix, _other)(self.path)
        if "distorted" in record:
            record["distorted"] = f"{record['distorted']} (scoup build needs --undistort)"
        for line in lines_of(record):
            console.say(line)
        following = "" if console.warnings else _next(self.path, record)
        if following:
            console.say(f"next: {following}")
        console.result(record)


def _next(path: Path, record: dict[str, Any]) -> str:
    """Return the command that follows from what a path is; "" where there is none."""
    if record["kind"] == "language field":
        return command("view", path)
    if record["kind"] == "splat":
        return f"{command('build', path)} (makes views of it first)"
    if record["kind"] != "scene" or "cameras" not in record:
        return ""
    splat = () if "splat" in record else ("--gaussians", "SPLAT")
    return command("build", path, *splat, *(("--undistort",) if "distorted" in record else ()))


def _other(path: Path) -> dict[str, Any]:
    from scoup.io import describe
    from scoup.uplift import RegionSums, fitting_scene, measure_fit

    if path.is_dir() and RegionSums.are_in(path):
        return RegionSums.open(path).describe()
    folder = describe(fitting_scene(path))
    if folder is None:
        return _word_table(path)
    if not (folder.splat and folder.gaussians and folder.cameras):
        return folder.record
    # As a build would find them.
    cameras = [camera for camera in folder.cameras if camera.image_path] or list(folder.cameras)
    fit = measure_fit(folder.gaussians, cameras, folder.splat.preset)
    if problem := fit.problem(cameras, folder.splat.path):
        warnings.warn(problem, ScoupWarning, stacklevel=2)
    return {**folder.record, "fit": fit.describe()}


def _word_table(path: Path) -> dict[str, Any]:
    from scoup.models import WordTable

    table = WordTable.load(path)
    record = {"kind": "word table", "names": list(table.names), "dim": table.vectors.shape[1]}
    return record | ({"embedding_model": table.model} if table.model else {})


def _field(path: Path) -> dict[str, Any]:
    from scoup.field import read_facts

    facts = read_facts(path)
    provenance = facts.pop("provenance")  # long, so last
    return {"kind": "language field", **facts, "provenance": provenance}


def lines_of(record: dict[str, Any], indent: str = "") -> Iterator[str]:
    """Yield a record for people: one line per entry, nested entries indented."""
    for key, value in record.items():
        name = f"{indent}{key.replace('_', ' ')}:"
        if isinstance(value, dict) and any(isinstance(item, (dict, list, str)) for item in value.values()):
            yield name
            yield from lines_of(value, indent + "  ")
        else:
            yield f"{name} {_readable(value)}"


def _readable(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{key} {_readable(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        items = ", ".join(_readable(item) for item in value[:12])
        return items + (f", ... ({len(value)} in all)" if len(value) > 12 else "")
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"{value:,}" if isinstance(value, int) else str(value)
