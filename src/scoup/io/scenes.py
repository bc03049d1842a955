"""From a path of any kind to Gaussians and cameras: every guess about a scene folder is made here."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from scoup.base.arguments import PATH, check_arguments
from scoup.base.counts import counted, listed
from scoup.base.errors import FileFormatError, InputError, MissingFileError, ScoupWarning
from scoup.io.camera_images import MissingImages, attach_images, image_files
from scoup.io.cameras.colmap import is_model, read_colmap
from scoup.io.cameras.gsplat_frame import in_gsplat_frame
from scoup.io.cameras.inria import latest_point_cloud, read_cfg_args, read_inria_cameras
from scoup.io.cameras.nerfstudio import read_transforms
from scoup.io.cameras.trained_frame import TRAINED_FRAME, in_trained_frame
from scoup.io.cameras.training_run import (
    GSPLAT_CONFIG,
    gsplat_data,
    is_gsplat_results,
    is_nerfstudio_run,
    nerfstudio_data,
)
from scoup.io.reading import Distorted
from scoup.io.splats.formats import READERS, WRITERS, check_splat_name, written_suffix
from scoup.io.splats.gsplat_checkpoint import exported_splat, read_gsplat_checkpoint
from scoup.io.splats.nerfstudio_checkpoint import is_splatfacto_name, read_splatfacto, splat_of_run
from scoup.io.splats.other_formats import READ, other_format
from scoup.io.splats.scenesplat import is_scenesplat, read_scenesplat
from scoup.scene.cameras import Cameras
from scoup.scene.gaussians import Gaussians

CameraFormat = Literal["colmap", "nerfstudio", "inria"]

_SPARSE = ("sparse", "sparse_pc")  # COLMAP's folder of models, and what nerfstudio makes of it
_CHECKPOINTS = (".pt", ".pth", ".ckpt")
_IN_FOLDERS = tuple(
    suffix for suffix in READERS if suffix not in (".glb", ".gltf")
)  # which may hold meshes as well
_MOST_FOLDERS = 100  # looked into for scenes


@dataclass(frozen=True)
class CameraSource:
    """Where the cameras of a scene are: format, file or model folder, folders that may hold images, other models of
    COLMAP beside the one taken, and what says in which frame the splat was trained: dataparser_transforms.json of
    nerfstudio, or cfg.yml of gsplat, whose trainer moves the world.
    """

    format: CameraFormat
    path: Path
    roots: tuple[Path, ...]
    others: tuple[Path, ...] = ()
    frame: Path | None = None


def load_gaussians(path: str | Path) -> Gaussians:
    """Load a trained splat, on the CPU.

    Args:
        path: a PLY of 3D Gaussian Splatting (also PlayCanvas's compressed one), a .splat, .spz, .glb, .gltf, .ksplat
            or .sog file; a gsplat checkpoint (.pt) or its ``ckpts`` folder; the output folder of a training by
            nerfstudio (splatfacto), by gsplat or by Inria's code (the last step is taken); a folder with SceneSplat's
            arrays (coord.npy and so on), or a folder with one such file.

    Raises:
        MissingFileError: there is nothing of the kind.
        FileFormatError: the file is damaged or of a kind not supported.

    Warns:
        ScoupWarning: rows were dropped because they are not finite, or the file is longer than it says.
    """
    check_arguments("load_gaussians", path=(path, PATH))
    path = find_gaussians(path)
    if is_scenesplat(path):
        gaussians = read_scenesplat(path)
    elif is_splatfacto_name(path):
        gaussians = read_splatfacto(path)
    elif path.is_dir() or path.suffix.lower() in _CHECKPOINTS:
        gaussians = read_gsplat_checkpoint(path)
    else:
        gaussians = READERS[path.suffix.lower()](path)
    if not len(gaussians):
        raise FileFormatError(path, "holds no Gaussians with finite values", "export the splat again")
    return gaussians


def save_gaussians(gaussians: Gaussians, path: str | Path, overwrite: bool = False) -> None:
    """Write a splat in the format of the suffix: .ply (Inria's layout), .compressed.ply (PlayCanvas), .splat, .spz,
    .glb, .gltf, .ksplat or .sog. All but .ply round values (docs/formats.md).

    Raises:
        InputError: another suffix, or values that the format has no place for.
        OutputExistsError: the file exists and ``overwrite`` is false.
        ScoupError: the format needs a package that is not there.
    """
    check_arguments("save_gaussians", gaussians=(gaussians, Gaussians), path=(path, PATH))
    check_splat_name(path)
    WRITERS[written_suffix(path)](gaussians, path, overwrite)


def default_preset(path: str | Path) -> Literal["inria", "gsplat"]:
    """The rasteriser preset of a splat: "gsplat" for checkpoints of its trainer and for SceneSplat's arrays, which were
    trained with it, otherwise "inria"."""
    folder = Path(path)
    if is_nerfstudio_run(folder) or is_gsplat_results(folder):
        return "gsplat"
    path = find_gaussians(path)
    return "gsplat" if path.is_dir() or path.suffix.lower() in _CHECKPOINTS else "inria"


def find_gaussians(path: str | Path) -> Path:
    """The file (or folder of checkpoints or arrays) that ``load_gaussians`` reads for ``path``.

    Raises:
        MissingFileError: there is none, or a folder holds several.
        FileFormatError: the file is of a kind not supported.
    """
    path = Path(path)
    if os.path.isfile(path):
        if path.suffix.lower() not in (*READERS, *_CHECKPOINTS):
            raise FileFormatError(
                path, *(other_format(path) or ("is not a kind of splat known here", f"give {READ}"))
            )
        return path
    if not os.path.isdir(path):
        raise MissingFileError(
            path, "there is no such file or folder (a trained splat was expected)", "check the path"
        )
    if path.name == "point_cloud" or (path / "point_cloud").is_dir():
        return latest_point_cloud(path)
    if is_scenesplat(path):
        return path
    if is_nerfstudio_run(path):
        return splat_of_run(path)
    if is_gsplat_results(path) and not any((path / "ckpts").glob("*.pt")):
        return exported_splat(path)
    if (path / "ckpts").is_dir() or any(path.glob("ckpt_*_rank*.pt")):
        return path
    # Inria's code copies the sparse points beside its cameras as input.ply.
    found = [
        item
        for item in sorted(path.iterdir())
        if item.suffix.lower() in _IN_FOLDERS and item.is_file() and item.name != "input.ply"
    ]
    if len(found) != 1:
        names = listed([item.name for item in found], 5)
        problem = f"holds {len(found)} splats ({names})" if found else "holds no trained splat"
        raise MissingFileError(path, problem, "name the file of the splat itself")
    return found[0]


def load_cameras(
    path: str | Path,
    images: str | Path | None = None,
    downscale: Literal[1, 2, 4, 8] | None = None,
    distorted: Distorted = "refuse",
    missing_images: MissingImages = "skip",
    dataparser_transforms: str | Path | None = None,
) -> Cameras:
    """Load the cameras of a scene, sorted by name, at the size of the images found for them.

    Args:
        path: a scene folder as COLMAP, nerfstudio or Inria's code leave it, or a transforms.json,
            cameras.json or COLMAP model folder itself; or the output folder of a training by nerfstudio or gsplat,
            whose data are then found, and the cameras brought to the frame of the splat.
        images: the folder with the photographs; by default ``images``, else ``images_2``, ``_4``, ``_8``.
        downscale: take the images (and cameras) at 1/downscale of full size, from ``images_<downscale>``
            if there is one. Intrinsics always follow the image size.
        distorted: "refuse" cameras with lens distortion, or "undistort": they carry their coefficients, and
            images and region maps are undistorted when they are read.
        missing_images: "skip" cameras whose image is missing where others have one, or "keep" them without.
        dataparser_transforms: bring the cameras to the frame of a splat that nerfstudio trained, by the file of that
            name in its output.

    Raises:
        MissingFileError: there are no cameras, or ``images`` is not there or has none of their images.
        FileFormatError: a file of cameras is damaged, an image has another shape than its camera, or see
            ``distorted``.

    Warns:
        ScoupWarning: cameras were skipped because their image is missing or cannot be read, no image was found at all
            and the cameras stand alone, or there are other models of COLMAP.
    """
    check_arguments("load_cameras", path=(path, PATH))
    if downscale not in (None, 1, 2, 4, 8):
        raise InputError(f"downscale is {downscale}, expected 1, 2, 4 or 8")
    if distorted not in ("refuse", "undistort"):
        raise InputError(f"distorted is {distorted!r}, expected 'refuse' or 'undistort'")
    if missing_images not in ("skip", "keep"):
        raise InputError(f"missing_images is {missing_images!r}, expected 'skip' or 'keep'")
    source = find_cameras(path)
    if source.others:
        others = ", ".join(str(other) for other in source.others)
        warnings.warn(
            f"{source.path}: used, and {counted(len(source.others), 'other COLMAP model')} not; to use another, give "
            f"its folder ({others})",
            ScoupWarning,
            stacklevel=2,
        )
    cameras = _read(source, distorted)
    frame = source.frame if dataparser_transforms is None else Path(dataparser_transforms)
    if frame is not None and frame.name == GSPLAT_CONFIG:
        cameras = in_gsplat_frame(cameras, source.path)
    elif frame is not None:
        transforms = source.path if source.format == "nerfstudio" else None
        cameras = in_trained_frame(cameras, frame, transforms)
    return attach_images(cameras, source.path, source.roots, images, downscale, missing_images)


def camera_photographs(path: str | Path, images: str | Path | None = None) -> list[tuple[str, Path]]:
    """Names of a scene's cameras and their photographs, where there are any; the photographs are not opened.

    Args:
        path, images: as in ``load_cameras``.

    Raises:
        MissingFileError: there are no cameras, or ``images`` is not there.
        FileFormatError: the cameras are damaged.
    """
    source = find_cameras(path)
    return image_files(_read(source, "undistort"), source.roots, images)


def find_cameras(path: str | Path) -> CameraSource:
    """Which cameras ``load_cameras`` reads for ``path``.

    In a folder with ``point_cloud`` (an output of Inria's code) its cameras.json comes first; otherwise a
    COLMAP model in ``sparse``, then transforms.json, then a model in ``colmap/sparse``, then cameras.json.

    Raises:
        MissingFileError: there are none.
        FileFormatError: the file is of another kind.
    """
    path = Path(path)
    if os.path.isfile(path):
        return _source_of_file(path)
    if not os.path.isdir(path):
        raise MissingFileError(
            path, "there is no such file or folder (a scene was expected)", "check the path"
        )
    inria = [path / "cameras.json"]
    if is_nerfstudio_run(path):
        return _source_of_run(path)
    if is_gsplat_results(path):
        data, normalised = gsplat_data(path)
        source = find_cameras(data)
        return replace(source, frame=path / GSPLAT_CONFIG if normalised else None)
    candidates = [
        *(inria if (path / "point_cloud").is_dir() else []),
        path / "sparse",
        path / "transforms.json",
        path / "colmap" / "sparse",
        path,
        *inria,
    ]
    for candidate in candidates:
        if candidate.is_file():
            return _source_of_file(candidate)
        models = _models(candidate)
        if models:
            return CameraSource("colmap", models[0], (scene_folder(models[0]),), tuple(models[1:]))
    raise MissingFileError(
        path, "holds no cameras (sparse/0, transforms.json or cameras.json)", where_cameras_are(path)
    )


def _source_of_run(run: Path) -> CameraSource:
    """The cameras of the data that a run of nerfstudio was trained on.

    Raises:
        MissingFileError: the data or the frame of the training are not there.
    """
    data, from_colmap = nerfstudio_data(run)
    frame = run / TRAINED_FRAME
    if not frame.is_file():
        problem = "is not there; without it nobody knows in which frame the splat was trained"
        raise MissingFileError(frame, problem, "copy it from the machine of the training")
    transforms = data / "transforms.json"
    source = find_cameras(data if from_colmap or not transforms.is_file() else transforms)
    return replace(source, frame=frame)


def scene_folder(path: str | Path) -> Path:
    """The scene that a path means: the folder of a cameras file, the one above COLMAP's ``sparse`` or ``sparse/0``, or
    the folder itself.
    """
    path = Path(path)
    folder = path.parent if path.is_file() else path
    if not _models(folder):
        return folder
    scene = folder.absolute()
    if scene.name == "0" or (scene.name.isdigit() and scene.parent.name in _SPARSE):
        scene = scene.parent
    for names in (_SPARSE, ("colmap",)):
        if scene.name in names:
            scene = scene.parent
    # Keep a relative path relative: it is shorter in messages.
    return scene if folder.is_absolute() else Path(os.path.relpath(scene))


def _models(folder: Path) -> list[Path]:
    """COLMAP's models in a folder: its numbered ones in order, and the folder itself."""
    if not folder.is_dir():
        return []
    numbered = sorted(
        (item for item in folder.iterdir() if item.name.isdigit()), key=lambda item: int(item.name)
    )
    return [item for item in (*numbered, folder) if is_model(item)]


def where_cameras_are(path: Path) -> str:
    """The remedy for a folder without cameras: the scene it is in, or the scenes in it, if there are any."""
    above = list(path.absolute().parents)[:3]
    if not path.is_absolute():
        above = [Path(os.path.relpath(place)) for place in above]
    below = [item for item in sorted(path.iterdir()) if item.is_dir()][:_MOST_FOLDERS]
    for places, what in ((above, "give the scene it is in"), (below, "give one of the scenes in it")):
        scenes = [str(place) for place in places if _has_cameras(place)][: 1 if places is above else 3]
        if scenes:
            return f"{what}: {', '.join(scenes)}"
    return "give a scene folder of COLMAP, nerfstudio or Inria's code"


def _has_cameras(folder: Path) -> bool:
    files = ("transforms.json", "cameras.json")
    return any((folder / name).is_file() for name in files) or bool(_models(folder / "sparse"))


def _source_of_file(path: Path) -> CameraSource:
    folder = path.parent
    if path.suffix.lower() in (".bin", ".txt") and is_model(folder):
        return CameraSource("colmap", folder, (scene_folder(folder),))
    if path.suffix.lower() != ".json":
        raise FileFormatError(
            path, "is not a kind of camera file known here", "give transforms.json or cameras.json"
        )
    with open(path, "rb") as stream:
        start = stream.read(4096).lstrip(b"\xef\xbb\xbf \t\r\n")
    # A list is Inria's, a mapping nerfstudio's, whatever the file is called.
    if start.startswith(b"["):
        return CameraSource("inria", path, _inria_roots(folder))
    return CameraSource("nerfstudio", path, (folder,))


def _inria_roots(folder: Path) -> tuple[Path, ...]:
    """The folder itself, and the training data that cfg_args names if they are on this machine."""
    if not (folder / "cfg_args").is_file():
        return (folder,)
    try:
        source = read_cfg_args(folder / "cfg_args").get("source_path")
    except FileFormatError:
        return (folder,)  # only a hint for finding images, not worth refusing cameras for
    if isinstance(source, str) and source and os.path.isdir(source):
        return (folder, Path(source))
    return (folder,)


def _read(source: CameraSource, distorted: Distorted) -> Cameras:
    if source.format == "colmap":
        return read_colmap(source.path, distorted)
    if source.format == "nerfstudio":
        return read_transforms(source.path, distorted)
    return read_inria_cameras(source.path)
