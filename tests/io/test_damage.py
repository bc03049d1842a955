"""Valid files of every format, cut, flipped and spliced: a reader succeeds or says what is wrong."""

from __future__ import annotations

import contextlib
import gzip
import os
import struct
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from foreign_samples import (
    LangSplatAutoencoder,
    save_langsplatv2,
    save_results,
    save_run,
    save_splatfacto,
)
from io_samples import (
    save_checkpoint,
    save_compressed_ply,
    save_images,
    some_cameras,
    some_gaussians,
    some_regions,
)
from scoup.base.errors import MissingFileError, ScoupError, ScoupWarning
from scoup.io import (
    load_cameras,
    load_gaussians,
    load_image,
    load_regions,
    read_cfg_args,
    read_points,
    save_gaussians,
    save_regions,
    write_colmap,
    write_inria_cameras,
    write_spz,
    write_transforms,
)
from scoup.io.langsplatv2 import read_langsplatv2
from scoup.io.regions.langsplat_autoencoder import read_autoencoder
from scoup.io.splats.gltf import read_gltf, read_gltf_features, write_gltf
from scoup.io.splats.gltf_features import GaussianFeatures
from scoup.io.splats.ply import table_from_gaussians

HUGE = [struct.pack("<Q", value) for value in (10**12, 2**32 - 1, 2**62, 2**63, 2**64 - 1)]
HUGE += [struct.pack("<I", value) for value in (2**31 - 1, 2**31, 2**32 - 1)]
HUGE += [struct.pack("<d", value) for value in (float("nan"), float("inf"), -1e308, 1e-300)]
WORDS = [
    b"1e400",
    b"-1",
    b"nan",
    b"999999999999999999999",
    b"null",
    b"[]",
    b"{}",
    b'"',
    b"\0",
    b"\xff",
    b"",
    b"\n",
]
MEMORY = 1 << 30  # bytes beyond what is in use already


@dataclass(frozen=True)
class Target:
    """A file of a valid sample, and what reads it to the end."""

    file: str
    read: Callable[[Path], object]


def read_all_regions(folder: Path) -> None:
    regions = load_regions(folder / "features", some_cameras(1))
    for level in regions.levels:
        regions.load(regions.view_names[0], level)


def read_all_gltf(path: Path) -> None:
    read_gltf(path)
    read_gltf_features(path)


def read_unpacked_spz(path: Path) -> None:
    """Damage within the compressed stream, which its checksum would hide."""
    packed = path.with_suffix(".packed.spz")
    if not path.is_file():
        raise MissingFileError(path, "is not there")
    packed.write_bytes(gzip.compress(path.read_bytes()))
    load_gaussians(packed)


def read_image(folder: Path) -> None:
    for camera in load_cameras(folder / "scene", missing_images="keep"):
        load_image(replace(camera, image_path=folder / "scene" / "images" / camera.name))


TARGETS = {
    "ply": Target("a.ply", lambda folder: load_gaussians(folder / "a.ply")),
    "ascii ply": Target("ascii.ply", lambda folder: load_gaussians(folder / "ascii.ply")),
    "compressed ply": Target("packed.ply", lambda folder: load_gaussians(folder / "packed.ply")),
    "spz": Target("a.spz", lambda folder: load_gaussians(folder / "a.spz")),
    "spz of streams": Target("streams.spz", lambda folder: load_gaussians(folder / "streams.spz")),
    "spz, unpacked": Target("a.unpacked", lambda folder: read_unpacked_spz(folder / "a.unpacked")),
    "splat": Target("a.splat", lambda folder: load_gaussians(folder / "a.splat")),
    "glb": Target("a.glb", lambda folder: read_all_gltf(folder / "a.glb")),
    "gltf": Target("a.gltf", lambda folder: read_all_gltf(folder / "a.gltf")),
    "checkpoint": Target("ckpts/ckpt_1_rank0.pt", lambda folder: load_gaussians(folder / "ckpts")),
    "splatfacto": Target(
        "run/nerfstudio_models/step-000000009.ckpt", lambda folder: load_gaussians(folder / "run")
    ),
    "config.yml": Target(
        "run/config.yml", lambda folder: load_cameras(folder / "run", missing_images="keep")
    ),
    "dataparser_transforms.json": Target(
        "run/dataparser_transforms.json", lambda folder: load_cameras(folder / "run", missing_images="keep")
    ),
    "cfg.yml": Target(
        "results/cfg.yml", lambda folder: load_cameras(folder / "results", missing_images="keep")
    ),
    "LangSplatV2": Target("v2.pth", lambda folder: read_langsplatv2(folder / "v2.pth")),
    "autoencoder": Target("best_ckpt.pth", lambda folder: read_autoencoder(folder / "best_ckpt.pth")),
    "cameras.bin": Target("scene/sparse/0/cameras.bin", lambda folder: load_cameras(folder / "scene")),
    "images.bin": Target("scene/sparse/0/images.bin", lambda folder: load_cameras(folder / "scene")),
    "points3D.bin": Target(
        "scene/sparse/0/points3D.bin", lambda folder: read_points(folder / "scene/sparse/0")
    ),
    "cameras.txt": Target("text/sparse/cameras.txt", lambda folder: load_cameras(folder / "text")),
    "images.txt": Target("text/sparse/images.txt", lambda folder: load_cameras(folder / "text")),
    "points3D.txt": Target("text/sparse/points3D.txt", lambda folder: read_points(folder / "text/sparse")),
    "transforms.json": Target("transforms.json", lambda folder: load_cameras(folder / "transforms.json")),
    "cameras.json": Target("cameras.json", lambda folder: load_cameras(folder / "cameras.json")),
    "cfg_args": Target("cfg_args", lambda folder: read_cfg_args(folder / "cfg_args")),
    "region labels": Target("features/view_00_s.npy", read_all_regions),
    "region embeddings": Target("features/view_00_f.npy", read_all_regions),
    "png": Target("scene/images/view_00.png", read_image),
}


@pytest.fixture(scope="module")
def sample() -> Iterator[Path]:
    """One valid file of every format."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        save_gaussians(some_gaussians(4), folder / "a.ply")
        save_gaussians(some_gaussians(4), folder / "a.splat")
        features = GaussianFeatures(torch.tensor([0, 1, -1, 1]), ("chair", "table"))
        write_gltf(some_gaussians(4), folder / "a.glb", features=features)
        write_gltf(some_gaussians(4), folder / "a.gltf", features=features)
        save_gaussians(some_gaussians(4), folder / "a.spz")
        write_spz(some_gaussians(4), folder / "streams.spz", version=4)
        (folder / "a.unpacked").write_bytes(gzip.decompress((folder / "a.spz").read_bytes()))
        save_compressed_ply(folder / "packed.ply", count=4)
        save_checkpoint(some_gaussians(4), folder / "ckpts" / "ckpt_1_rank0.pt")
        names = table_from_gaussians(some_gaussians(1, degree=0)).names
        header = [
            "ply",
            "format ascii 1.0",
            "element vertex 3",
            *(f"property float {item}" for item in names),
        ]
        rows = [" ".join(f"{row + column / 8}" for column in range(len(names))) for row in range(3)]
        (folder / "ascii.ply").write_text("\n".join([*header, "end_header", *rows, ""]))
        cameras = some_cameras(2)
        points = (
            some_gaussians(3).means.numpy().astype(float),
            (some_gaussians(3).means.numpy() > 0).astype("u1"),
        )
        write_colmap(cameras, folder / "scene" / "sparse" / "0", points)
        write_colmap(cameras, folder / "text" / "sparse", points, text=True)
        save_images(cameras, folder / "scene" / "images")
        write_transforms(cameras, folder / "transforms.json")
        write_inria_cameras(cameras, folder / "cameras.json")
        (folder / "cfg_args").write_text("Namespace(sh_degree=3, source_path='a', eval=False)")
        save_regions(some_regions(some_cameras(1, width=8, height=6)), folder / "features")
        save_run(folder / "run", "scene", "colmap_dataparser.ColmapDataParserConfig")
        save_splatfacto(some_gaussians(4), folder / "run" / "nerfstudio_models" / "step-000000009.ckpt")
        save_results(folder / "results", folder / "scene")
        (folder / "results" / "ckpts").mkdir()
        save_langsplatv2(some_gaussians(4), folder / "v2.pth")
        torch.save(LangSplatAutoencoder([4, 3], [4, 8], dim=8).state_dict(), folder / "best_ckpt.pth")
        yield folder


@contextlib.contextmanager
def little_memory() -> Iterator[None]:
    """Taking much memory is a MemoryError here, which no reader may let through."""
    if not sys.platform.startswith("linux"):
        yield
        return
    import resource

    used = int(Path("/proc/self/statm").read_text().split()[0]) * os.sysconf("SC_PAGE_SIZE")
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def check(target: Target, folder: Path, damaged: bytes) -> bool:
    """Whether the damaged file was read; it is put right again."""
    path = folder / target.file
    valid = path.read_bytes()
    path.write_bytes(damaged)
    try:
        with warnings.catch_warnings(), little_memory():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", ScoupWarning)
            try:
                target.read(folder)
            except ScoupError as error:
                message = str(error)
                assert path.stem.split("_")[0] in message or "ckpts" in message, message
                assert "\n" not in message
                return False
            return True
    finally:
        path.write_bytes(valid)


@st.composite
def damage(draw: st.DrawFn, valid: bytes) -> bytes:
    data = bytearray(valid)
    for _ in range(draw(st.integers(1, 3))):
        place = draw(st.integers(0, len(data)))
        match draw(st.sampled_from(["cut", "flip", "huge", "word", "remove", "repeat"])):
            case "cut":
                del data[place:]
            case "flip":
                data[place : place + 1] = bytes([draw(st.integers(0, 255))])
            case "huge":
                value = draw(st.sampled_from(HUGE))
                data[place : place + len(value)] = value
            case "word":
                data[place : place + draw(st.integers(0, 8))] = draw(st.sampled_from(WORDS))
            case "remove":
                del data[place : place + draw(st.integers(1, 40))]
            case _:
                data[place:place] = data[place : place + draw(st.integers(1, 40))]
    return bytes(data)


@pytest.mark.parametrize("kind", TARGETS)
def test_samples_are_valid(sample, kind):
    assert check(TARGETS[kind], sample, (sample / TARGETS[kind].file).read_bytes())


# An empty points3D.txt means that there are no points.
@pytest.mark.parametrize("kind", [kind for kind in TARGETS if kind != "points3D.txt"])
def test_empty_files(sample, kind):
    assert not check(TARGETS[kind], sample, b"")


@pytest.mark.parametrize("kind", TARGETS)
def test_missing_files(sample, kind):
    path = sample / TARGETS[kind].file
    valid = path.read_bytes()
    path.unlink()
    try:
        with warnings.catch_warnings(), contextlib.suppress(ScoupError):
            warnings.simplefilter("ignore", ScoupWarning)
            TARGETS[kind].read(sample)
    finally:
        path.write_bytes(valid)


@pytest.mark.parametrize("kind", TARGETS)
def test_cut_files(sample, kind):
    valid = (sample / TARGETS[kind].file).read_bytes()
    for length in range(0, len(valid), max(1, len(valid) // 60)):
        check(TARGETS[kind], sample, valid[:length])


@pytest.mark.parametrize("kind", TARGETS)
def test_huge_numbers_in_the_head(sample, kind):
    valid = (sample / TARGETS[kind].file).read_bytes()
    for place in range(0, min(len(valid), 32), 4):
        for value in HUGE:
            check(TARGETS[kind], sample, valid[:place] + value + valid[place + len(value) :])


@pytest.mark.parametrize("kind", TARGETS)
@settings(max_examples=60, suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_damaged_files(sample, kind, data):
    check(TARGETS[kind], sample, data.draw(damage((sample / TARGETS[kind].file).read_bytes())))


@pytest.mark.parametrize("kind", TARGETS)
def test_files_of_other_kinds(sample, kind):
    for other in TARGETS.values():
        check(TARGETS[kind], sample, (sample / other.file).read_bytes())
