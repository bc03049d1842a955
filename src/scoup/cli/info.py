"""scoup info: what is in a file or folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import tyro

from scoup.cli.console import Common, Console

if TYPE_CHECKING:
    from scoup.cameras import Cameras
    from scoup.gaussians import Gaussians


@dataclass(frozen=True, kw_only=True)
class Info(Common):
    """Say what is in a file or folder: a field, a splat, a scene, a table of words, region features."""

    path: tyro.conf.Positional[Path]
    """A .scoup, .ply, .splat, .pt, .npz, .json or .safetensors file, or a folder."""

    def run(self, console: Console) -> None:
        """Find out the kind, check the contents, and print what they are."""
        from scoup.errors import MissingFileError

        if not self.path.exists():
            raise MissingFileError(self.path, "there is no such file or folder", "check the path")
        record = _describe_folder(self.path) if self.path.is_dir() else _describe_file(self.path)
        for key, value in record.items():
            console.say(f"{key.replace('_', ' ')}: {_readable(value)}")
        console.result(record)


def _describe_file(path: Path) -> dict[str, Any]:
    from scoup.errors import FileFormatError
    from scoup.io import load_cameras, load_gaussians
    from scoup.text_table import load_table

    suffix = path.suffix.lower()
    if suffix == ".scoup":
        return _describe_field(path)
    if suffix in (".ply", ".splat", ".pt", ".pth"):
        return {"kind": "splat", **_describe_gaussians(load_gaussians(path))}
    if suffix in (".npz", ".safetensors"):
        table = load_table(path)
        return {"kind": "table of text embeddings", "names": list(table.names), "dim": table.vectors.shape[1]}
    if suffix in (".json", ".bin", ".txt"):
        try:
            return {"kind": "cameras", **_describe_cameras(load_cameras(path, missing_images="keep"))}
        except FileFormatError:
            if suffix != ".json":
                raise
            table = load_table(path)
            return {"kind": "table of text embeddings", "names": list(table.names), "dim": table.vectors.shape[1]}
    raise FileFormatError(path, "is not a kind of file known here", "see scoup info --help")


def _describe_folder(path: Path) -> dict[str, Any]:
    from scoup.errors import MissingFileError
    from scoup.io import find_cameras, find_gaussians, load_cameras, load_gaussians, load_regions

    record: dict[str, Any] = {"kind": "scene"}
    cameras = None
    try:
        record["cameras_from"] = str(find_cameras(path).path)
        cameras = load_cameras(path)
        record |= _describe_cameras(cameras)
    except MissingFileError:
        record["cameras"] = 0
    try:
        splat = find_gaussians(path)
        record["splat"] = str(splat)
        record |= _describe_gaussians(load_gaussians(splat))
    except MissingFileError:
        record["splat"] = None
    if cameras is not None:
        try:
            regions = load_regions(path, cameras)
            record["views_with_regions"] = len(regions)
            record["regions"] = {level: len(regions.embeddings(level)[0]) for level in regions.levels}
        except MissingFileError:
            record["views_with_regions"] = 0
    return record


def _describe_field(path: Path) -> dict[str, Any]:
    from scoup.field import LanguageField

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
        "geometry": None if field.geometry_path is None else str(field.geometry_path),
        "fingerprint": field.info.fingerprint,
        "accumulators": field.accumulators is not None,
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
    sizes = sorted({(camera.width, camera.height) for camera in cameras})
    return {
        "cameras": len(cameras),
        "sizes": [f"{width} x {height}" for width, height in sizes[:5]],
        "with_image": sum(camera.image_path is not None for camera in cameras),
        "first": cameras.names[0] if len(cameras) else None,
        "last": cameras.names[-1] if len(cameras) else None,
    }


def _readable(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} {_readable(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        shown = ", ".join(_readable(item) for item in value[:12])
        return shown + (f", ... ({len(value)} in all)" if len(value) > 12 else "")
    return f"{value:,}" if isinstance(value, int) and not isinstance(value, bool) else str(value)
