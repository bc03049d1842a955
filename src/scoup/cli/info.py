"""scoup info: what is in a file or folder."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from scoup.cli.console import Console
from scoup.cli.options import Common, common_last

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.scene.cameras import Cameras
    from scoup.scene.gaussians import Gaussians


@common_last
@dataclass(frozen=True, kw_only=True)
class Info(Common):
    """Say what is in a file or folder: a field, a splat, cameras, a scene, region features, a table of words."""

    path: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="PATH", help_behavior_hint="")]
    """A .scoup, .ply, .splat, .pt, .npz, .json or .safetensors file, or a folder."""

    def run(self, console: Console) -> None:
        """Find out the kind, check the contents, and print what they are."""
        from scoup.base.errors import MissingFileError

        if not self.path.exists():
            raise MissingFileError(self.path, "there is no such file or folder", "check the path")
        record = _describe_folder(self.path) if self.path.is_dir() else _describe_file(self.path)
        for line in _lines(record):
            console.say(line)
        console.result(record)


def _describe_file(path: Path) -> dict[str, Any]:
    from scoup.base.errors import FileFormatError
    from scoup.io import load_gaussians

    suffix = path.suffix.lower()
    if suffix == ".scoup":
        return _describe_field(path)
    if suffix in (".ply", ".splat", ".pt", ".pth"):
        return {"kind": "splat", **_describe_gaussians(load_gaussians(path))}
    if suffix in (".npz", ".safetensors"):
        return _describe_table(path)
    if suffix in (".json", ".bin", ".txt"):
        try:
            return {"kind": "cameras", **_describe_cameras(_cameras(path))}
        except FileFormatError:
            if suffix != ".json":
                raise
            return _describe_table(path)
    raise FileFormatError(path, "is not a kind of file known here", "see scoup info --help")


def _describe_table(path: Path) -> dict[str, Any]:
    from scoup.models.word_table import load_table

    table = load_table(path)
    record = {"kind": "table of words", "names": list(table.names), "dim": table.vectors.shape[1]}
    return record | ({"embedding_model": table.model} if table.model else {})


def _describe_folder(path: Path) -> dict[str, Any]:
    """A scene, or what there is of one: a part that is missing is left out, a damaged one is an error."""
    from scoup.base.errors import FileFormatError, MissingFileError
    from scoup.io import find_cameras, find_gaussians, load_gaussians, load_regions
    from scoup.io.regions.views import view_files

    record: dict[str, Any] = {"kind": "scene"}
    cameras = None
    with suppress(MissingFileError):
        record["cameras_from"] = str(find_cameras(path).path)
        cameras = _cameras(path)
        record |= _describe_cameras(cameras)
    with suppress(MissingFileError):
        splat = find_gaussians(path)
        record["splat"] = str(splat)
        record |= _describe_gaussians(load_gaussians(splat))
    if cameras is not None:
        with suppress(MissingFileError):
            regions = load_regions(path, cameras)
            record["views_with_regions"] = len(regions)
            record["regions"] = {level: len(regions.embeddings(level)[0]) for level in regions.levels}
    elif views := view_files(path, ".regions"):
        record |= _describe_compact(path, views)
    elif labels := sorted(path.glob("*_s.npy")):
        record |= _describe_features(labels)
    if len(record) == 1:
        raise FileFormatError(
            path, "holds nothing known here: no cameras, no splat, no region features", "check the path"
        )
    return record


def _describe_compact(folder: Path, files: list[Path]) -> dict[str, Any]:
    """Region features in the compact layout, without the cameras they belong to."""
    from scoup.io.regions.compact import read_compact_view
    from scoup.io.regions.manifest import read_manifest

    manifest = read_manifest(folder)
    views = [read_compact_view(path) for path in files]
    counted = [view for view in views if manifest is None or view.manifest == manifest.fingerprint]
    first = views[0]
    return {
        "kind": "region features",
        "views": len(counted),
        "sizes": sorted({f"{view.width} x {view.height}" for view in views}),
        "regions": {level: sum(view.rows.get(level, 0) for view in counted) for level in first.levels},
        "dim": first.dim,
        "bytes_a_view": sum(path.stat().st_size for path in files) // len(files),
        "embedding_model": manifest.embedding_model if manifest else "",
        "settings": manifest.settings if manifest else {},
        "first": first.name,
        "last": views[-1].name,
    }


def _describe_features(labels: list[Path]) -> dict[str, Any]:
    """Region features without the cameras they belong to; ``labels`` are the ``_s.npy`` files."""
    from scoup.io.npy import open_npy

    views = [path.name.removesuffix("_s.npy") for path in labels]
    sizes, rows, dims = set(), 0, set()
    for view, path in zip(views, labels, strict=True):
        height, width = open_npy(path, "region labels").shape[-2:]
        embeddings = open_npy(path.with_name(f"{view}_f.npy"), "region embeddings")
        sizes.add(f"{width} x {height}")
        rows += len(embeddings)
        dims.add(embeddings.shape[-1])
    return {
        "kind": "region features",
        "views": len(views),
        "sizes": sorted(sizes),
        "regions": rows,
        "dim": sorted(dims)[0] if len(dims) == 1 else sorted(dims),
        "first": views[0],
        "last": views[-1],
    }


def _cameras(path: Path) -> Cameras:
    """The cameras there are, distorted ones included."""
    from scoup.io import load_cameras

    return load_cameras(path, distorted="undistort", missing_images="keep")


def _describe_field(path: Path) -> dict[str, Any]:
    from scoup.field.language_field import LanguageField
    from scoup.uplift.region_sums import sums_path

    field = LanguageField.load(path)
    size = path.stat().st_size
    return {
        "kind": "language field",
        "gaussians": len(field),
        "coded": int(field.coded().sum()),
        "levels": list(field.levels),
        "atoms": field.n_atoms,
        "k": field.code_indices.shape[2],
        "dim": field.dim,
        "embedding_model": field.info.embedding_model,
        "raster_preset": field.info.raster_preset,
        "bytes": size,
        "bytes_a_gaussian": round(size / max(1, len(field)), 1),
        "cameras": 0 if field.cameras is None else len(field.cameras),
        "geometry": _where(field),
        "fingerprint": field.info.fingerprint,
        "region_sums": sums.stat().st_size if (sums := sums_path(path)).is_file() else None,
        "provenance": field.info.provenance,
    }


def _describe_gaussians(gaussians: Gaussians) -> dict[str, Any]:
    record: dict[str, Any] = {"gaussians": len(gaussians), "sh_degree": gaussians.sh_degree}
    if len(gaussians):
        record |= {
            "lowest": [round(value, 4) for value in gaussians.means.amin(0).tolist()],
            "highest": [round(value, 4) for value in gaussians.means.amax(0).tolist()],
            "median_scale": float(f"{float(gaussians.scales.median()):.4g}"),
            "median_opacity": round(float(gaussians.opacities.median()), 3),
        }
    return record | {"fingerprint": gaussians.fingerprint()}


def _describe_cameras(cameras: Cameras) -> dict[str, Any]:
    distorted = sum(bool(camera.distortion) for camera in cameras)
    sizes = sorted({(camera.width, camera.height) for camera in cameras})
    return {
        "cameras": len(cameras),
        "sizes": [f"{width} x {height}" for width, height in sizes[:5]],
        "with_image": sum(camera.image_path is not None for camera in cameras),
        "first": cameras.names[0] if len(cameras) else None,
        "last": cameras.names[-1] if len(cameras) else None,
        **({"distorted": f"{distorted} (scoup build needs --undistort)"} if distorted else {}),
    }


def _where(field: LanguageField) -> str | None:
    """Where the geometry of a field is."""
    if field.has_geometry:
        return "embedded"
    if field.geometry_path is None:
        return None
    return str(field.geometry_path) + ("" if field.geometry_path.exists() else " (not there)")


def _lines(record: dict[str, Any], indent: str = "") -> Iterator[str]:
    """A record for people: one line an entry, the entries of entries indented."""
    for key, value in record.items():
        name = f"{indent}{key.replace('_', ' ')}:"
        if isinstance(value, dict) and any(isinstance(item, (dict, list, str)) for item in value.values()):
            yield name
            yield from _lines(value, indent + "  ")
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
        shown = ", ".join(_readable(item) for item in value[:12])
        return shown + (f", ... ({len(value)} in all)" if len(value) > 12 else "")
    if isinstance(value, float):
        return f"{value:.4g}"
    return f"{value:,}" if isinstance(value, int) else str(value)
