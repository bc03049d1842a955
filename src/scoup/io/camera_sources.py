"""Search for the cameras of a scene: every guess about folders and files of cameras is made here."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from scoup.base import Entry, FileFormatError, MissingFileError, Registry
from scoup.io.cameras.colmap import is_model, model_images, read_colmap
from scoup.io.cameras.inria import read_cfg_args, read_inria_cameras
from scoup.io.cameras.nerfstudio import read_transforms
from scoup.io.cameras.trained_frame import TRAINED_FRAME
from scoup.io.cameras.training_run import (
    GSPLAT_CONFIG,
    TRANSFORMS,
    gsplat_data,
    is_gsplat_results,
    is_nerfstudio_run,
    nerfstudio_data,
)
from scoup.io.image_folder import EXTENSIONS
from scoup.io.reading import Distorted, read_bytes
from scoup.scene import Cameras

_SPARSE = ("sparse", "sparse_pc")  # COLMAP's folder of models, and what nerfstudio makes of it
_MOST_FOLDERS = 100  # looked into for scenes


@dataclass(frozen=True)
class CameraFormat(Entry):
    """A format of cameras: how to recognise and read it."""

    read: Callable[[Path, Distorted], Cameras]
    """Takes a file (of COLMAP a folder), and what to do about lens distortion."""
    takes: Callable[[Path], bool]
    """Tells if an existing file is of this format; the first format that takes a file reads it."""
    files: tuple[str, ...] = ()
    """Names of its files in the folder of a scene."""


def _is_of_model(path: Path) -> bool:
    return path.suffix.lower() in (".bin", ".txt") and is_model(path.parent)


def _is_list(path: Path) -> bool:
    blank = b"\xef\xbb\xbf \t\r\n"
    return path.suffix.lower() == ".json" and read_bytes(path)[:4096].lstrip(blank).startswith(b"[")


_COLMAP = CameraFormat("colmap", read_colmap, _is_of_model)
# A list is Inria's, any other JSON nerfstudio's, whatever the file is called.
_INRIA = CameraFormat("inria", lambda path, _: read_inria_cameras(path), _is_list, ("cameras.json",))
_NERFSTUDIO = CameraFormat(
    "nerfstudio", read_transforms, lambda path: path.suffix.lower() == ".json", TRANSFORMS
)
CAMERA_FORMATS = Registry(
    "camera format", "scoup.camera_formats", CameraFormat, (_COLMAP, _INRIA, _NERFSTUDIO)
)


@dataclass(frozen=True)
class CameraSource:
    """Source of the cameras of a scene: format, file or model folder, folders that may hold images, other models of
    COLMAP beside the one taken, what says in which frame the splat was trained (dataparser_transforms.json of
    nerfstudio, or cfg.yml of gsplat, whose trainer moves the world), and models with as many but other images or poses.
    """

    format: str
    path: Path
    roots: tuple[Path, ...]
    others: tuple[Path, ...] = ()
    frame: Path | None = None
    rivals: tuple[Path, ...] = ()


def find_cameras(path: str | Path) -> CameraSource:
    """Return the source of the cameras that ``load_cameras`` reads for ``path``.

    In a folder with ``point_cloud`` (an output of Inria's code) its cameras.json comes first; otherwise a COLMAP model
    in ``sparse``, then transforms.json (or transforms_train.json), then a model in ``colmap/sparse``, then files of the
    other formats.
    """
    path = Path(path)
    if os.path.isfile(path):
        return _source_of_file(path)
    if not os.path.isdir(path):
        raise MissingFileError.of(path, "a scene", kind="file or folder")
    if is_nerfstudio_run(path):
        return _source_of_run(path)
    if is_gsplat_results(path):
        return _source_of_results(path)
    return _source_of_folder(path)


def _source_of_data(path: Path) -> CameraSource:
    """Return the cameras of the data of a training, which may lie in the folder of the training itself."""
    return _source_of_file(path) if path.is_file() else _source_of_folder(path, trained=True)


def _source_of_folder(path: Path, trained: bool = False) -> CameraSource:
    """Return the cameras of a scene: of several models of COLMAP the one with most images, or the first where the data
    are those of a training, which takes it."""
    candidates = [
        *([path / "cameras.json"] if (path / "point_cloud").is_dir() else []),
        path / "sparse",
        *(path / name for name in TRANSFORMS),
        path / "colmap" / "sparse",
        path,
        *(path / name for name in _file_names()),
    ]
    for candidate in candidates:
        if candidate.is_file():
            return _source_of_file(candidate)
        models = _models(candidate)
        if models:
            images = {item: set(() if trained or len(models) == 1 else model_images(item)) for item in models}
            first, *others = sorted(models, key=lambda model: -len(images[model]))
            same = [model for model in others if len(images[model]) == len(images[first])]
            rivals = tuple(model for model in same if images[model] != images[first])
            return CameraSource("colmap", first, (scene_folder(first),), tuple(others), rivals=rivals)
    for candidate in candidates:
        for folder in sorted(candidate.glob("[0-9]*")) + [candidate]:
            _check_whole(folder)
    looked_for = ", ".join(["sparse/0", *_file_names()])
    raise MissingFileError(path, f"contains no cameras ({looked_for})", where_cameras_are(path))


def _file_names() -> list[str]:
    """Return the names of files of cameras in the folder of a scene."""
    return [name for kind in CAMERA_FORMATS.values() for name in kind.files]


def _check_whole(folder: Path) -> None:
    """Raise a MissingFileError if a folder has one of the two files of a COLMAP model."""
    for end in (".bin", ".txt"):
        there = {name: (folder / f"{name}{end}").is_file() for name in ("cameras", "images")}
        if len(set(there.values())) == 2 and (there["cameras"] or end == ".bin"):
            has, lacks = sorted(there, key=lambda name: not there[name])
            problem = f"has {has}{end} but not {lacks}{end}, which COLMAP writes beside it"
            raise MissingFileError(folder, problem, "copy the whole model")


def _source_of_run(run: Path) -> CameraSource:
    """Return the cameras of the data that a run of nerfstudio was trained on."""
    data, from_colmap = nerfstudio_data(run)
    frame = run / TRAINED_FRAME
    if not frame.is_file():
        problem = "is not there; without it nobody knows in which frame the splat was trained"
        raise MissingFileError(frame, problem, "copy it from the machine of the training")
    transforms = [data / name for name in TRANSFORMS if (data / name).is_file()]
    source = _source_of_data(data if from_colmap or not transforms else transforms[0])
    return replace(source, frame=frame)


def _source_of_results(results: Path) -> CameraSource:
    """Return the cameras of the data that gsplat's trainer was given."""
    data, normalised = gsplat_data(results)
    source, config = _source_of_data(data), results / GSPLAT_CONFIG
    if source.format != "colmap":
        problem = f"names {data}, which is not a COLMAP scene, as gsplat's trainer needs one"
        raise FileFormatError(config, problem, "the file is damaged, or the data have changed since")
    return replace(source, frame=config if normalised else None)


def scene_folder(path: str | Path) -> Path:
    """Return the scene that a path means: the folder of a cameras file, the one above COLMAP's ``sparse`` or
    ``sparse/0``, or the folder itself.
    """
    path = Path(path)
    folder = path.parent if path.is_file() else path
    if not _models(folder):
        return folder
    scene = folder.absolute()
    is_numbered = scene.name == "0" or (scene.name.isdigit() and scene.parent.name in _SPARSE)
    for names in ((scene.name,) if is_numbered else (), _SPARSE, ("colmap",)):
        # A scene may have such a name, too.
        if scene.name in names and not any(map(Path.is_dir, scene.glob("images*"))):
            scene = scene.parent
    # Keep a relative path relative: it is shorter in messages.
    return scene if folder.is_absolute() else Path(os.path.relpath(scene))


def _models(folder: Path) -> list[Path]:
    """Return COLMAP's models in a folder: its numbered ones in order, and the folder itself."""
    if not folder.is_dir():
        return []
    numbered = sorted(
        (item for item in folder.iterdir() if item.name.isdigit()), key=lambda item: int(item.name)
    )
    return [item for item in (*numbered, folder) if is_model(item)]


def where_cameras_are(path: Path) -> str:
    """Return the remedy for a folder without cameras: the scene it is in, or the scenes in it, if there are any."""
    above = list(path.absolute().parents)[:3]
    if not path.is_absolute():
        above = [Path(os.path.relpath(folder)) for folder in above]
    below = [item for item in sorted(path.iterdir()) if item.is_dir()][:_MOST_FOLDERS]
    for places, what in ((above, "use the scene it is in"), (below, "use one of the scenes in it")):
        scenes = [str(folder) for folder in places if has_cameras(folder)][: 1 if places is above else 3]
        if scenes:
            return f"{what}: {', '.join(scenes)}"
    if files := sorted(str(file) for file in path.glob("*transforms*.json"))[:3]:
        return f"pass the file itself: {', '.join(files)}"
    folders = (path, path / "images", path / "input")
    if any(
        file.suffix.lower() in EXTENSIONS
        for folder in folders
        if folder.is_dir()
        for file in folder.iterdir()
    ):
        return "find the cameras of its photographs with COLMAP or ns-process-data, then train a splat"
    return "use a scene folder of COLMAP, nerfstudio or Inria's code"


def has_cameras(folder: Path) -> bool:
    """Tell whether a folder is that of a scene, by its files of cameras."""
    return any((folder / name).is_file() for name in _file_names()) or bool(_models(folder / "sparse"))


def camera_format(path: Path) -> CameraFormat | None:
    """Return the format of a file of cameras; None if it is another file."""
    return next((kind for kind in CAMERA_FORMATS.values() if kind.takes(path)), None)


def _source_of_file(path: Path) -> CameraSource:
    folder, kind = path.parent, camera_format(path)
    if kind is None:
        names = " or ".join(_file_names())
        raise FileFormatError(path, "is not a known kind of camera file", f"use {names}")
    if kind is _COLMAP:
        return CameraSource(kind.name, folder, (scene_folder(folder),))
    return CameraSource(kind.name, path, _inria_roots(folder) if kind is _INRIA else (folder,))


def _inria_roots(folder: Path) -> tuple[Path, ...]:
    """Return the folder itself, and the training data that cfg_args names if they are on this machine."""
    if not (folder / "cfg_args").is_file():
        return (folder,)
    try:
        source = read_cfg_args(folder / "cfg_args").get("source_path")
    except FileFormatError:
        return (folder,)  # only a hint for finding images, not worth refusing cameras for
    if isinstance(source, str) and source and os.path.isdir(source):
        return (folder, Path(source))
    return (folder,)
