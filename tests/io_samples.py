"""Small valid files of every format, and comparisons, shared by the io tests."""

from __future__ import annotations

import gzip
import json
import math
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image
from tests.support import random_gaussians

from scoup.base import WorldFrame
from scoup.io import RegionManifest, ViewRegions
from scoup.io.regions.compact import write_view
from scoup.io.regions.manifest import write_manifest
from scoup.io.splats.spz import write_spz
from scoup.scene import (
    LEVELS,
    Camera,
    Cameras,
    Gaussians,
    RegionMap,
    Regions,
    quats_of_rotations,
    rotation_matrices,
)

MANIFEST_OF_TESTS = RegionManifest("some/model", {"segmenter": "random"})
TURNED = np.array([[0, -2.0, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]])
PLACE = WorldFrame(0.25, (0.1, -0.9, 0.2), (0.8, 0.1, 0.5), (48.2082, 16.3738, 187.5), "map")
APPLIED = [[0.0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0]]  # of ns-process-data
POINT_HEADER = "\n".join([
    "ply", "format {encoding} 1.0", "element vertex {count}", *(f"property float {axis}" for axis in "xyz"),
    *(f"property uchar {color}" for color in ("red", "green", "blue", "alpha")), "property ushort label",
    "element face 1", "property list uchar int vertex_indices", "end_header", "",
])  # fmt: skip


def some_gaussians(count: int = 7, degree: int = 1, seed: int = 0) -> Gaussians:
    return random_gaussians(count, seed, degree=degree)


def tame(count: int, degree: int, seed: int, largest: float = 4.0, most_sh: float = 0.9) -> Gaussians:
    """Gaussians within the ranges of formats that round."""
    made = some_gaussians(count, degree, seed)
    sh = made.sh.clamp(-3, 3)
    sh[:, 1:] = made.sh[:, 1:].clamp(-most_sh, most_sh)
    means = made.means / made.means.abs().max().clamp(min=1e-3) * largest
    return Gaussians(means, made.quats, made.scales.clamp(5e-5, 300), made.opacities, sh)


def same_gaussians(one: Gaussians, other: Gaussians) -> bool:
    """Equal bit by bit (a negative zero counts as zero)."""
    pairs = zip(one.tensors().values(), other.tensors().values(), strict=True)
    return one.antialiased == other.antialiased and all(torch.equal(*pair) for pair in pairs)


def angles(one: torch.Tensor, other: torch.Tensor) -> torch.Tensor:
    """Degrees between rotations."""
    return torch.rad2deg(2 * torch.acos((one.double() * other.double()).sum(1).abs().clamp(max=1)))


def covariances(gaussians: Gaussians) -> torch.Tensor:
    """[N, 3, 3] float64."""
    axes = rotation_matrices(gaussians.quats.double()) * gaussians.scales.double()[:, None]
    return axes @ axes.transpose(1, 2)


def heights(gaussians: Gaussians) -> np.ndarray:
    """Metres, in the frame of the Gaussians."""
    up = torch.tensor(gaussians.world.up or (0, -1, 0), dtype=torch.float64)
    return ((gaussians.world.metres_per_unit or 1) * gaussians.means.double() @ up).numpy()


def some_cameras(
    count: int = 3, width: int = 32, height: int = 24, seed: int = 0, centered: bool = False
) -> Cameras:
    generator = np.random.default_rng(seed)
    cameras = []
    for number in range(count):
        rotation, _ = np.linalg.qr(generator.normal(size=(3, 3)))
        rotation *= np.sign(np.linalg.det(rotation))
        viewmat = np.eye(4)
        viewmat[:3, :3], viewmat[:3, 3] = rotation, generator.normal(size=3)
        cx, cy = (width / 2, height / 2) if centered else (width / 2 + 0.7, height / 2 - 1.3)
        intrinsics = torch.tensor([[30.5, 0, cx], [0, 31.25, cy], [0, 0, 1]], dtype=torch.float64)
        name = f"view_{number:02d}.png"
        cameras.append(Camera(name, torch.from_numpy(viewmat), intrinsics, width, height))
    return Cameras(cameras)


def camera_difference(one: Cameras, other: Cameras) -> float:
    """Largest difference of poses and intrinsics; infinite if names or sizes differ."""
    if one.names != other.names or [(c.width, c.height) for c in one] != [(c.width, c.height) for c in other]:
        return math.inf
    pairs = list(zip(one, other, strict=True))
    return max(float(max((a.viewmat - b.viewmat).abs().max(), (a.K - b.K).abs().max())) for a, b in pairs)


def some_regions(cameras: Cameras, dimensions: int = 8, seed: int = 0) -> Regions:
    """Random maps in which every region has a pixel."""
    generator = torch.Generator().manual_seed(seed)
    maps: dict[str, dict[str, RegionMap]] = {camera.name: {} for camera in cameras}
    for camera in cameras:
        for count, level in zip((6, 4, 2), LEVELS, strict=True):
            labels = torch.randint(-1, count, (camera.height, camera.width), generator=generator).int()
            labels.view(-1)[:count] = torch.arange(count, dtype=torch.int32)
            rows = torch.nn.functional.normalize(torch.randn(count, dimensions, generator=generator), dim=1)
            maps[camera.name][level] = RegionMap(labels, rows)
    return Regions.from_maps(maps)


def stored_view(regions: Regions, name: str, dtype: str = "<f4", photograph: str = "") -> ViewRegions:
    """The regions of one view as they are stored."""
    maps = {level: regions.load(name, level) for level in LEVELS}
    labels = {level: item.labels.numpy() for level, item in maps.items()}
    rows = {level: item.embeddings.numpy().astype(dtype) for level, item in maps.items()}
    return ViewRegions(name, labels, rows, photograph)


def save_langsplat(regions: Regions, folder: Path) -> None:
    """Write the files of LangSplat: labels are rows of all levels, one after the other; "default" is empty."""
    for name in regions.view_names:
        maps, start = [regions.load(name, level) for level in LEVELS], 0
        planes = [np.full(maps[0].labels.shape, -1, np.float32)]
        for item in maps:
            planes.append(np.where(item.labels >= 0, item.labels.numpy() + start, -1).astype(np.float32))
            start += len(item.embeddings)
        rows = torch.cat([item.embeddings for item in maps]).numpy()
        save_npy(folder, Path(name).name.partition(".")[0], np.stack(planes), rows)


def save_npy(folder: Path, stem: str, planes: np.ndarray, rows: np.ndarray) -> Path:
    """Labels and embeddings of a view in the layout of LangSplat."""
    folder.mkdir(parents=True, exist_ok=True)
    np.save(folder / f"{stem}_s.npy", planes)
    np.save(folder / f"{stem}_f.npy", rows)
    return folder


def unit_rows(count: int, dimensions: int = 4) -> np.ndarray:
    rows = np.random.default_rng(count).normal(size=(count, dimensions)).astype(np.float32)
    return rows / np.linalg.norm(rows, axis=1, keepdims=True)


def planes_of(*values: list[int], width: int = 32, height: int = 24) -> np.ndarray:
    """Planes that hold the given labels in turn."""
    planes = [np.resize(np.array(item, np.float32), height * width).reshape(height, width) for item in values]
    return np.stack(planes)


def save_compact(folder: Path, cameras: Cameras, bits: int = 32) -> Regions:
    """Write the regions of ``some_regions`` in the compact layout."""
    regions = some_regions(cameras)
    folder.mkdir(exist_ok=True, parents=True)
    write_manifest(folder, MANIFEST_OF_TESTS)
    for camera in cameras:
        view = stored_view(regions, camera.name, f"f{bits // 8}", "photo")
        write_view(folder, camera.stem, view, MANIFEST_OF_TESTS.fingerprint)
    return regions


def save_images(cameras: Cameras, folder: Path, divisor: int = 1) -> None:
    """A PNG of noise for every camera."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, camera in enumerate(cameras):
        shape = (camera.height // divisor, camera.width // divisor, 3)
        pixels = np.random.default_rng(number).integers(0, 256, shape).astype(np.uint8)
        Image.fromarray(pixels).save(folder / camera.name)


def raw_columns(count: int = 5, rest: int = 0, seed: int = 0) -> dict[str, np.ndarray]:
    """Random columns of a PLY of Inria's layout."""
    generator = np.random.default_rng(seed)
    names = ["x", "y", "z", *(f"f_dc_{c}" for c in range(3)), *(f"f_rest_{number}" for number in range(rest))]
    names += ["opacity", *(f"scale_{axis}" for axis in range(3)), *(f"rot_{part}" for part in range(4))]
    return {name: generator.normal(size=count).astype(np.float32) for name in names}


def ply_file(path: Path, columns: dict[str, np.ndarray], encoding: str = "binary_little_endian") -> Path:
    """A PLY written by other means than those tested."""
    order = ">" if "big" in encoding else "<"
    names = {"f4": "float", "f8": "double", "u1": "uchar", "u2": "ushort", "i4": "int"}
    kinds = [(name, order + values.dtype.str[1:]) for name, values in columns.items()]
    rows = np.empty(len(next(iter(columns.values()))), kinds)
    for key, values in columns.items():
        rows[key] = values
    lines = [f"property {names[values.dtype.str[1:]]} {name}" for name, values in columns.items()]
    start = ["ply", f"format {encoding} 1.0", f"element vertex {len(rows)}"]
    body = rows.tobytes()
    if encoding == "ascii":
        body = b"".join(" ".join(repr(float(each)) for each in row).encode() + b"\n" for row in rows.tolist())
    path.write_bytes("\n".join([*start, *lines, "end_header", ""]).encode() + body)
    return path


def save_compressed_ply(path: Path, count: int = 300, rest: int = 9, seed: int = 0) -> None:
    """Random packed bits in the layout of PlayCanvas, with an ``sh`` element of ``rest`` properties."""
    generator, chunks = np.random.default_rng(seed), -(-count // 256)
    sides = ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"]
    chunk = [f"property float {end}_{side}" for side in sides for end in ("min", "max")]
    vertex = [f"property uint packed_{name}" for name in ("position", "rotation", "scale", "color")]
    extra = [f"property uchar f_rest_{number}" for number in range(rest)]
    header = ["ply", "format binary_little_endian 1.0", f"element chunk {chunks}", *chunk]
    header += [f"element vertex {count}", *vertex, f"element sh {count}", *extra, "end_header", ""]
    body = np.tile(np.array([-1.5, 0.5], "<f4"), chunks * len(sides)).tobytes()
    body += generator.integers(0, 2**32, (count, 4), dtype=np.uint32).tobytes()
    body += generator.integers(0, 256, (count, rest), dtype=np.uint8).tobytes()
    path.write_bytes("\n".join(header).encode() + body)


def save_spz(gaussians: Gaussians, path: Path, version: int) -> None:
    """A .spz file of any version; 1 and 2, which are not written, are made of 3 by means of the layout alone."""
    write_spz(gaussians, path, overwrite=True, version=max(version, 3))
    if version > 2:
        return
    body = gzip.decompress(path.read_bytes())
    count, degree, bits, flags = struct.unpack_from("<8xIBBB", body)
    ends = np.cumsum([16, *(count * size for size in (9, 1, 3, 3, 4, 3 * ((degree + 1) ** 2 - 1)))])
    rows = [np.frombuffer(body[a:b], np.uint8).reshape(count, -1) for a, b in pairwise(ends)]
    if version == 1:
        fixed = np.pad(rows[0].reshape(-1, 3), ((0, 0), (1, 0))).view("<i4") >> 8
        rows[0] = (fixed / 2**bits).astype("<f2").reshape(count, 3)
    word = np.ascontiguousarray(rows[4]).view("<u4")[:, 0].astype(int)
    fields = np.stack([word >> shift & 1023 for shift in (20, 10, 0)], axis=1)
    others = (fields & 511) / 511 * 0.5**0.5 * np.where(fields > 511, -1, 1)
    largest = np.sqrt((1 - (others**2).sum(1)).clip(0))
    quats = np.stack([np.insert(*row) for row in zip(others, word >> 30, largest, strict=True)])
    rows[4] = np.rint(quats[:, :3] * np.where(quats[:, 3:] < 0, -1, 1) * 127.5 + 127.5).astype(np.uint8)
    start = struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, bits, flags, 0)
    path.write_bytes(gzip.compress(start + b"".join(row.tobytes() for row in rows), mtime=0))


def save_checkpoint(gaussians: Gaussians, path: Path, **changes: Any) -> Path:
    """What gsplat's trainer writes for one rank, with other tensors in the place of some."""
    path.parent.mkdir(parents=True, exist_ok=True)
    splats = {
        "means": gaussians.means, "quats": gaussians.quats * 1.7, "scales": gaussians.scales.log(),
        "opacities": torch.logit(gaussians.opacities), "sh0": gaussians.sh[:, :1].clone(),
        "shN": gaussians.sh[:, 1:].clone(), **changes,
    }  # fmt: skip
    torch.save({"step": 100, "splats": splats}, path)
    return path


def write_inria_cameras(cameras: Cameras, path: str | Path) -> None:
    """Write cameras.json. The layout has no principal point; readers take the image centre."""
    entries = [
        {
            "id": number, "img_name": each.name, "width": each.width, "height": each.height,
            "position": each.position.tolist(), "rotation": each.viewmat[:3, :3].T.tolist(),
            "fy": each.fy, "fx": each.fx,
        }
        for number, each in enumerate(cameras)
    ]  # fmt: skip
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    Path(path).write_text(json.dumps(entries, indent=1) + "\n")


def write_colmap_text(
    cameras: Cameras, folder: Path, points: tuple[np.ndarray, np.ndarray] | None = None
) -> None:
    """Write a COLMAP model in text, with a lens for each camera."""
    folder.mkdir(parents=True, exist_ok=True)
    quats = quats_of_rotations(torch.stack([camera.viewmat[:3, :3] for camera in cameras])).tolist()
    lenses, images = ["# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]"], ["# IMAGE_ID, QW, QX, ..."]
    for number, (camera, quat) in enumerate(zip(cameras, quats, strict=True), start=1):
        parameters = f"{camera.fx!r} {camera.fy!r} {camera.cx!r} {camera.cy!r}"
        lenses.append(f"{number} PINHOLE {camera.width} {camera.height} {parameters}")
        pose = " ".join(map(repr, (*quat, *camera.viewmat[:3, 3].tolist())))
        images += [f"{number} {pose} {number} {camera.name}", ""]
    positions, colors = (np.zeros((0, 3)), np.zeros((0, 3))) if points is None else points
    rows = enumerate(zip(positions.tolist(), colors.tolist(), strict=True), start=1)
    lines = [" ".join(map(repr, (number, *position, *color, 0))) for number, (position, color) in rows]
    for name, content in (("cameras", lenses), ("images", images), ("points3D", lines)):
        (folder / f"{name}.txt").write_text("\n".join(content) + "\n")


def text_model(folder: Path, lens: str, images: str = "1 1 0 0 0 0.5 0.25 2 1 a b.jpg\n\n") -> Path:
    """A COLMAP model of these lines."""
    folder.mkdir(exist_ok=True)
    (folder / "cameras.txt").write_text(f"# cameras\n{lens}\n")
    (folder / "images.txt").write_text(f"# images\n{images}")
    return folder


DISTORTED = {  # lenses of COLMAP
    "radial 1": "1 SIMPLE_RADIAL 40 30 50 20 15 0.1", "radial": "1 RADIAL 40 30 50 20 15 0.1 -0.02",
    "OpenCV": "1 OPENCV 40 30 50 51 20 15 0.1 -0.02 0.001 0.002",
}  # fmt: skip


def transforms(folder: Path, frame: dict[str, Any] | None = None, **settings: Any) -> Path:
    """A transforms.json of one frame at (1, 2, 3), looking along its -z."""
    pose = [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
    frames = [{"file_path": "./images/a.png", "transform_matrix": pose, **(frame or {})}]
    content = {"w": 32, "h": 24, "fl_x": 30.0, "frames": frames, **settings}
    content = {key: value for key, value in content.items() if value is not None}
    (folder / "transforms.json").write_text(json.dumps(content))
    return folder / "transforms.json"
