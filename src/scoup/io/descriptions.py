"""Descriptions of splats, cameras, region features and scene folders, as plain values for people and JSON."""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scoup.base import FileFormatError, InputError, MissingFileError, ScoupWarning, foreign_kind
from scoup.io.camera_sources import camera_format, find_cameras, scene_folder
from scoup.io.images import image_fault
from scoup.io.reading import read_json
from scoup.io.regions.load import load_regions
from scoup.io.regions.store import RegionStore
from scoup.io.scene_parts import ScenePaths
from scoup.io.scenes import all_cameras, camera_photographs, load_gaussians
from scoup.io.splats.formats import SplatSource, is_splat_name, other_format, read_endings, splat_source
from scoup.scene import Cameras, Gaussians, codes_problem, sanity_problems


def describe(path: Path) -> Described | None:
    """Describe a splat or cameras; None for JSON of a word table. Of a folder a scene, or region features alone;
    missing parts are left out."""
    if path.is_dir():
        return _describe_folder(path)
    record = _describe_file(path)
    return None if record is None else Described(record)


def _describe_file(path: Path) -> dict[str, Any] | None:
    suffix = path.suffix.lower()
    if suffix == ".json" and not is_splat_name(path):
        return _describe_cameras_of(path) if _is_cameras(path) else None
    if suffix in (".bin", ".txt") or (suffix != ".json" and camera_format(path)):
        return _describe_cameras_of(path)
    if is_splat_name(path):
        return {"kind": "splat", **describe_gaussians(load_gaussians(path))}
    readable = (
        f"read are fields (.scoup), splats ({read_endings()}), cameras (transforms.json, "
        "cameras.json, COLMAP's .bin and .txt), word tables (.npz, .json, .safetensors), and folders of scenes, "
        "region features and region sums"
    )
    raise FileFormatError(path, *(other_format(path) or ("is not a known kind of file", readable)))


def _is_cameras(path: Path) -> bool:
    """Tell whether JSON contains cameras; a FileFormatError if it is not a word table either."""
    if path.name in ("transforms.json", "cameras.json"):
        return True
    content = read_json(path, "cameras or a word table").value
    if isinstance(content, list) or (isinstance(content, dict) and "frames" in content):
        return True
    if isinstance(content, dict) and any(isinstance(value, list) for value in content.values()):
        return False
    problem = "is JSON of another kind than cameras (with frames) or a word table (lists of numbers by names)"
    other = problem, "name the file of the splat, cameras or words itself"
    raise FileFormatError(path, *(foreign_kind(content if isinstance(content, dict) else ()) or other))


def _describe_cameras_of(path: Path) -> dict[str, Any]:
    return {"kind": "cameras", **describe_cameras(all_cameras(path)), **describe_unreadable(path)}


def describe_gaussians(gaussians: Gaussians) -> dict[str, Any]:
    for problem in sanity_problems(gaussians):
        warnings.warn(problem, ScoupWarning, stacklevel=2)
    record: dict[str, Any] = {"gaussians": len(gaussians), "sh_degree": gaussians.sh_degree}
    record |= {"antialiased": True} if gaussians.antialiased else {}
    if len(gaussians):
        record |= {
            "lowest": [round(value, 4) for value in gaussians.means.amin(0).tolist()],
            "highest": [round(value, 4) for value in gaussians.means.amax(0).tolist()],
            "median_scale": float(f"{float(gaussians.scales.median()):.4g}"),
            "median_opacity": round(float(gaussians.opacities.median()), 3),
        }
    return record | {"fingerprint": gaussians.fingerprint()}


def describe_cameras(cameras: Cameras) -> dict[str, Any]:
    distorted = sum(bool(camera.distortion) for camera in cameras)
    sizes = sorted({(camera.width, camera.height) for camera in cameras})
    return {
        "cameras": len(cameras),
        "sizes": [f"{width} x {height}" for width, height in sizes[:5]],
        "with_image": sum(camera.image_path is not None for camera in cameras),
        "first": cameras.names[0] if len(cameras) else None,
        "last": cameras.names[-1] if len(cameras) else None,
        **({"distorted": distorted} if distorted else {}),
    }


def describe_unreadable(path: Path) -> dict[str, Any]:
    """Return the photographs of a scene's cameras that cannot be decoded, and why; nothing where all can be."""
    faults = {name: image_fault(image) for name, image, _ in camera_photographs(path)[0]}
    unreadable = [f"{name} {fault}" for name, fault in faults.items() if fault]
    return {"unreadable_photographs": len(unreadable), "unreadable": unreadable} if unreadable else {}


def describe_regions(store: RegionStore) -> dict[str, Any]:
    """Describe region features without their cameras: ``regions`` is their number at each level, or of all levels where
    headers do not tell them apart."""
    stems = store.stems()
    views = [store.open_view(stem) for stem in stems]
    counts: Counter[str] = Counter()
    for view in views:
        counts.update(view.counts)
    dims = sorted({view.dim for view in views})
    _warn_of_codes(dims)
    return {
        "kind": "region features",
        "layout": store.layout,
        "views": len(views),
        "sizes": sorted({f"{view.width} x {view.height}" for view in views}),
        "regions": counts["all"] if list(counts) == ["all"] else dict(counts),
        "dim": dims[0] if len(dims) == 1 else dims,
        "bytes_a_view": sum(map(store.size_of, stems)) // max(1, len(stems)),
        "embedding_model": store.manifest.embedding_model if store.manifest else "",
        "settings": store.manifest.settings if store.manifest else {},
        "first": views[0].name if views else None,
        "last": views[-1].name if views else None,
    }


@dataclass(frozen=True, eq=False)
class Described:
    """The description of a file or folder, and what was loaded for a folder: the splat and its Gaussians, the cameras;
    None if there are none.
    """

    record: dict[str, Any]
    splat: SplatSource | None = None
    gaussians: Gaussians | None = None
    cameras: Cameras | None = None


def _warn_of_codes(dims: Iterable[int]) -> None:
    for problem in filter(None, map(codes_problem, dims)):
        warnings.warn(problem, ScoupWarning, stacklevel=3)


def _describe_regions_of(path: Path, cameras: Cameras) -> dict[str, Any]:
    """Return the regions of cameras; where a build would find none, it warns of the reason."""
    folder = ScenePaths(path).features(to_make=True)
    if not folder.is_dir():
        return {}
    try:
        regions = load_regions(folder, cameras)
    except InputError as error:
        if isinstance(error, FileFormatError) and not isinstance(error, MissingFileError):
            raise
        warnings.warn(str(error), ScoupWarning, stacklevel=3)
        return {}
    embeddings = {level: regions.embeddings(level)[0] for level in regions.levels}
    _warn_of_codes({rows.shape[1] for rows in embeddings.values()})
    counts = {level: len(rows) for level, rows in embeddings.items()}
    return {"views_with_regions": len(regions), "regions": counts}


def _describe_folder(path: Path) -> Described:
    record: dict[str, Any] = {}
    splat, gaussians, cameras = None, None, None
    no_cameras = MissingFileError(path, "")
    try:
        record["cameras_from"] = str(find_cameras(path).path)
        cameras = all_cameras(path)
        record |= describe_cameras(cameras) | describe_unreadable(path)
        record |= _describe_regions_of(path, cameras)
    except MissingFileError as error:
        no_cameras = error
    try:
        splat = splat_source(scene_folder(path))
        gaussians = load_gaussians(splat.path)
        record |= {"splat": str(splat.path), **describe_gaussians(gaussians)}
        no_splat = ""
    except MissingFileError as error:
        no_splat = error.problem
    if "cameras" not in record and (store := RegionStore.open(path)).stems():
        record |= describe_regions(store)
    broken = bool(no_cameras.problem) and not no_cameras.problem.startswith("contains no cameras")
    if broken and record:  # half of a model, or data of a training that are gone
        warnings.warn(str(no_cameras), ScoupWarning, stacklevel=2)
    lacks = {"cameras": "cameras", "splat": "trained splat", "regions": "region features"}
    not_found = [what for key, what in lacks.items() if key not in record]
    if not record:
        if broken:
            raise no_cameras
        raise FileFormatError(
            path,
            f"contains nothing that SCOUP reads: it has no region features, {no_splat}, and {no_cameras.problem}",
            no_cameras.remedy,
        )
    if "trained splat" in not_found:
        not_found[not_found.index("trained splat")] += f" ({no_splat})"
    if not_found and "kind" not in record:  # of a scene
        record["not_found"] = not_found
    return Described({"kind": "scene", **record}, splat, gaussians, cameras)
