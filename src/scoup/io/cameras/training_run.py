"""Folders that trainers write (nerfstudio's runs, gsplat's results), and the data that they were trained on.

Their configurations are YAML with tags that name Python objects. They are never loaded: the few lines that are needed
are read as text.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from scoup.base import MissingFileError
from scoup.io.cameras.trained_frame import TRAINED_FRAME
from scoup.io.reading import read_text

GSPLAT_CONFIG = "cfg.yml"
TRANSFORMS = ("transforms.json", "transforms_train.json")  # the second of NeRF-synthetic scenes
_ABOVE = 8  # folders above a run that are looked into for its data
_MOST_PARTS = 64  # of the end of a named path that is looked for: each part is tried in every folder
_KEY = re.compile(r"^( *)data: *(.*)$")


def is_nerfstudio_run(folder: str | Path) -> bool:
    folder = Path(folder)
    beside = (folder / "nerfstudio_models").is_dir() or (folder / TRAINED_FRAME).is_file()
    return (folder / "config.yml").is_file() and beside


def is_gsplat_results(folder: str | Path) -> bool:
    folder = Path(folder)
    return (folder / GSPLAT_CONFIG).is_file() and any((folder / name).is_dir() for name in ("ckpts", "ply"))


def nerfstudio_data(run: Path) -> tuple[Path, bool]:
    """Return the data of a run of nerfstudio, and whether its cameras were read from COLMAP's model."""
    config = run / "config.yml"
    text = read_text(config)
    remedy = f"use the scene folder with its cameras, and pass `dataparser_transforms={run / TRAINED_FRAME}`"
    named = _named_path(text)
    if named is None:
        raise MissingFileError(config, "does not name the folder of the training data", remedy)
    return _on_this_machine(named, run, config, remedy), "ColmapDataParserConfig" in text


def gsplat_data(results: Path) -> tuple[Path, bool]:
    """Return the data of gsplat's results, and whether the trainer normalised their world."""
    config = results / GSPLAT_CONFIG
    text = read_text(config)
    remedy = f"copy the COLMAP scene it was trained on beside {results}, with the folder name given there"
    named = _plain(text, "data_dir")
    if named is None:
        raise MissingFileError(config, "does not name the folder of the training data (data_dir)", remedy)
    normalised = (_plain(text, "normalize_world_space") or "true").lower() == "true"
    return _on_this_machine(named, results, config, remedy), normalised


def trained_antialiased(folder: Path) -> bool:
    """Return whether a configuration of gsplat or nerfstudio says that its splat was trained with antialiasing."""
    said = {GSPLAT_CONFIG: "^antialiased: *true", "config.yml": "^ *rasterize_mode: *antialiased"}
    configs = {folder / name: pattern for name, pattern in said.items() if (folder / name).is_file()}
    return any(re.search(pattern, read_text(config), re.MULTILINE) for config, pattern in configs.items())


def trained_as(file: Path) -> str:
    """Return the kind of Gaussians (model_type, such as 2dgs) by gsplat's configuration above a file; "" if unsaid."""
    for folder in list(file.absolute().parents)[:2]:
        if (folder / GSPLAT_CONFIG).is_file():
            return (_plain(read_text(folder / GSPLAT_CONFIG), "model_type") or "").lower()
    return ""


def _named_path(text: str) -> str | None:
    """Return the first path that a key ``data`` of nerfstudio's config names: a string, or a list of the parts of a
    path.
    """
    lines = text.splitlines()
    for number, line in enumerate(lines):
        matched = _KEY.match(line)
        if matched is None:
            continue
        value = re.sub(r"^&\w+ *", "", matched[2]).strip()
        if value.startswith("!!python/object/apply:pathlib."):
            parts = _items(lines[number + 1 :], len(matched[1]))
            if parts:
                return "/".join(parts).replace("//", "/", 1)
        elif (path := _scalar(value)) is not None:
            return path
    return None


def _items(lines: list[str], indent: int) -> list[str]:
    """Return the items of the list that begins at the first line, no less indented than its key."""
    items = []
    for line in lines:
        stripped = line.lstrip(" ")
        if not stripped.startswith("- ") or len(line) - len(stripped) < indent:
            break
        items.append(stripped[2:].strip().strip("'\""))
    return items


def _plain(text: str, key: str) -> str | None:
    """Return the scalar of a key at the beginning of a line; None for none."""
    matched = re.search(rf"^{key}: *(.*?) *$", text, re.MULTILINE)
    return None if matched is None else _scalar(matched[1])


def _scalar(value: str) -> str | None:
    """Return a scalar of YAML, without its quotes; None for null, and for tags, anchors, aliases and collections."""
    is_scalar = value and value not in ("null", "~") and not value.startswith(("!", "&", "*", "{", "["))
    return value.strip("'\"") if is_scalar else None


def _on_this_machine(named: str, run: Path, config: Path, remedy: str) -> Path:
    """Locate the data that a configuration names: as named, or below a folder above the run."""
    path = Path(named.replace("\\", "/"))
    if _holds_cameras(path):
        return path
    above = [run.absolute(), *list(run.absolute().parents)[:_ABOVE]]
    parts = [name for name in path.parts if name not in (path.anchor, "..")][-_MOST_PARTS:]
    # The longest existing end of the named path with cameras in it: data are moved with their last folders.
    for start in range(len(parts)):
        for folder in above:
            candidate = folder.joinpath(*parts[start:])
            if _holds_cameras(candidate):
                return candidate
    raise MissingFileError(config, f"was trained on {named}, which is not on this machine", remedy)


def _holds_cameras(path: Path) -> bool:
    """Return whether a path is transforms.json, or a folder that may be the data of a training."""
    if os.path.isfile(path):  # Path.is_file raises for names that the system does not take
        return path.suffix == ".json"
    return any(os.path.exists(path / name) for name in (*TRANSFORMS, "sparse", "colmap/sparse"))
