"""Every reader of files: which of the samples it reads, and how it reads them to the end."""

from __future__ import annotations

import gzip
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from tests.fuzzing import containers as of
from tests.fuzzing.containers import Container
from tests.fuzzing.samples import KEPT, OTHER_SPLATS, PICTURES, SIZE

from scoup.archive import Archive
from scoup.base import FileFormatError, InputError, MissingFileError
from scoup.base.native import missing_reason
from scoup.field import part_sizes, read_facts
from scoup.io import (
    RegionStore,
    load_cameras,
    load_gaussians,
    load_image,
    load_regions,
    read_autoencoder,
    read_langsplat,
    read_points,
    read_tracks,
)
from scoup.io.cameras.inria import read_cfg_args
from scoup.io.detections import DetectionStore
from scoup.io.images import image_fault
from scoup.io.regions.store import read_view
from scoup.io.splats.gltf import read_gltf
from scoup.models import WordTable
from scoup.query import LanguageField
from scoup.scene import Camera, Cameras, SparseCodes
from scoup.uplift import RegionSums, vote
from scoup.uplift.storage.array_file import view_file
from scoup_lab.data.labelled_points import read_labelled_ply
from scoup_lab.data.labels import read_labels
from scoup_lab.evaluate.protocols.threed_ovs import read_mask


@dataclass(frozen=True)
class Memory:
    """The memory that reading a file may take: ``times`` its size, and ``megabytes`` more."""

    times: int = 64
    megabytes: int = 64

    def bytes(self, size: int) -> int:
        """Return the allowance of a file of so many bytes."""
        return self.times * size + (self.megabytes << 20)


MEMORY = Memory()
PIXELS = Memory(13_000, 512)  # images: 1100 pixels per byte and 2^25 besides are decoded, at about 12 bytes
MASKS = Memory(64, 768)  # labels: masks of 2^28 pixels besides
SPZ = Memory(1500, 64)  # a hundred times the file, and 4 MB besides, are unpacked
TABLES = Memory(128, 128)  # of .npz twenty times the file, and 16 MB besides, are unpacked
LABELS = Memory(6000, 64)  # label maps without a region are packed a thousandfold
ARCHIVES = Memory(64, 1024)  # DuckDB's threads
MOST_REGIONS = 16  # of a view that votes


@dataclass(frozen=True)
class Reader:
    """One reader of files."""

    file: str  # of the samples, that is damaged
    read: Callable[[Path], object]  # reads it to the end, given the folder of the samples
    more: tuple[str, ...] = ()  # further valid samples that stand in its place
    # in which damage is put inside, with lengths and checksums that fit
    containers: tuple[Container, ...] = ()
    memory: Memory = MEMORY  # what reading may take
    # of the files that other readers are given; for those that start a process for every file
    share: float = 1.0


def _splat(
    file: str, *more: str, containers: tuple[Container, ...] = (), memory: Memory = MEMORY, share: float = 1.0
) -> Reader:
    return Reader(file, lambda folder: load_gaussians(folder / file), more, containers, memory, share)


def _cameras(file: str, source: str) -> Reader:
    return Reader(file, lambda folder: load_cameras(folder / source, missing_images="keep"))


def _sparse(file: str, model: str) -> Reader:
    return Reader(file, lambda folder: (read_points(folder / model), read_tracks(folder / model)))


def _gltf(file: str, *more: str, container: Container, memory: Memory = MEMORY) -> Reader:
    return Reader(file, lambda folder: read_gltf(folder / file), more, (container,), memory)


def _unpacked_spz(folder: Path) -> None:
    """Damage within the compressed stream, which its checksum would hide."""
    packed, plain = folder / "a.packed.spz", folder / "a.unpacked"
    if not plain.is_file():
        raise MissingFileError(plain, "is not there")
    packed.write_bytes(gzip.compress(plain.read_bytes(), 1))
    load_gaussians(packed)


def _regions(folder: Path) -> None:
    camera = Camera("view_00.png", torch.eye(4), torch.tensor([[9.0, 0, 4], [0, 9, 3], [0, 0, 1]]), *SIZE)
    regions = load_regions(folder, Cameras([camera]))
    for level in regions.levels:
        regions.load(regions.view_names[0], level)
    store = RegionStore.open(folder)
    view = store.view("view_00")
    if view is not None:
        read_view(view)


def _detections(file: str) -> Reader:
    return Reader(
        f"concepts/{file}", lambda folder: DetectionStore.open(folder / "concepts").read("view_00.png")
    )


def _field(file: str, *more: str) -> Reader:
    def read(folder: Path) -> None:
        read_facts(folder / file)
        field = LanguageField.load(folder / file)
        part_sizes(folder / file)
        len(field.gaussians)

    return Reader(file, read, more, (of.SAFETENSORS, of.SEALED))


def _sums(folder: Path) -> None:
    """Open a file, list its entries, and run a round of the vote by every backend of the processor."""
    path = folder / "a.sums"
    try:
        sums = RegionSums.open(path)
        for name in sums.views:
            for level in range(len(sums.levels)):
                sums.triplets(name, level)
        _vote(sums)
    except FileFormatError:
        raise
    except InputError as error:  # whoever uses the sums knows their folder
        raise FileFormatError(path, str(error)) from error


def _vote(sums: RegionSums) -> None:
    counts = [sums.n_regions(name) for name in sums.views]
    if not counts or not 0 < max(map(max, counts)) <= MOST_REGIONS:
        return  # build refuses such sums, since its regions are others
    rows = [{name: slice(0, MOST_REGIONS) for name in sums.views} for _ in sums.levels]
    atoms = torch.arange(MOST_REGIONS)[:, None].to(torch.uint8)
    codes = [SparseCodes(atoms, torch.ones(MOST_REGIONS, 1), MOST_REGIONS) for _ in sums.levels]
    codebook = torch.eye(MOST_REGIONS).expand(len(sums.levels), -1, -1)
    for backend in ("reference", *(["native"] if missing_reason() is None else [])):
        vote(sums.select(sums.views, rows), codes, codebook, keep=1, backend=backend)


def _archive(file: str, *containers: Container) -> Reader:
    def read(folder: Path) -> None:
        archive = Archive(folder / "archive", KEPT / "scene" / "words.npz")
        archive.find("kettle")
        archive.find("kettle", where="floor = 2")

    return Reader(f"archive/{file}", read, (), containers, ARCHIVES, share=0.3)


def _picture(file: str, *more: str, containers: tuple[Container, ...] = ()) -> Reader:
    def read(folder: Path) -> None:
        path = folder / "pictures" / file
        matrix = torch.tensor([[9.0, 0, 16], [0, 9, 12], [0, 0, 1]])
        image_fault(path)
        load_image(Camera(file, torch.eye(4), matrix, 32, 24, path))
        read_mask(path, 127)

    places = tuple(f"pictures/{name}" for name in more)
    return Reader(f"pictures/{file}", read, places, containers, PIXELS)


def _words(file: str, *more: str, containers: tuple[Container, ...] = (), memory: Memory = MEMORY) -> Reader:
    return Reader(file, lambda folder: WordTable.load(folder / file), more, containers, memory)


_SPZ = ("many.spz", "version1.spz", "version2.spz", "alike.spz")

READERS: Mapping[str, Reader] = {
    "ply": _splat("a.ply", "many.ply", containers=(of.PLY,)),
    "ascii ply": _splat("ascii.ply", "ascii_many.ply", containers=(of.PLY,)),
    "compressed ply": _splat("packed.ply", "packed_many.ply", containers=(of.PLY,)),
    "splat": _splat("a.splat", "many.splat"),
    "spz": _splat("a.spz", *_SPZ, containers=(of.GZIP,), memory=SPZ),
    "spz of streams": _splat("version4.spz", "many4.spz", "alike4.spz", containers=(of.STREAMS,), memory=SPZ),
    "spz, unpacked": Reader("a.unpacked", _unpacked_spz, memory=SPZ),
    "glb": _gltf("a.glb", "many.glb", container=of.GLB),
    "spz in glb": _gltf("spz.glb", container=of.GLB, memory=SPZ),
    "gltf": _gltf("a.gltf", "many.gltf", container=of.BASE64),
    "checkpoint": Reader("ckpts/ckpt_1_rank0.pt", lambda folder: load_gaussians(folder / "ckpts"), ("other.pt",),
                         containers=(of.ZIP,)),
    "splatfacto": Reader("run/nerfstudio_models/step-000000009.ckpt", lambda folder: load_gaussians(folder / "run"),
                         ("older.ckpt",), containers=(of.ZIP,)),
    "LangSplatV2": Reader("v2.pth", lambda folder: read_langsplat(folder / "v2.pth"), containers=(of.ZIP,)),
    "autoencoder": Reader("best_ckpt.pth", lambda folder: read_autoencoder(folder / "best_ckpt.pth"),
                          containers=(of.ZIP,)),
    "labelled ply": Reader("labelled.ply", lambda folder: read_labelled_ply(folder / "labelled.ply"), (), (of.PLY,)),
    "cameras.bin": _cameras("scene/sparse/0/cameras.bin", "scene"),
    "images.bin": _cameras("scene/sparse/0/images.bin", "scene"),
    "points3D.bin": _sparse("scene/sparse/0/points3D.bin", "scene/sparse/0"),
    "cameras.txt": _cameras("text/sparse/cameras.txt", "text"),
    "images.txt": _cameras("text/sparse/images.txt", "text"),
    "points3D.txt": _sparse("text/sparse/points3D.txt", "text/sparse"),
    "transforms.json": _cameras("transforms.json", "transforms.json"),
    "cameras.json": _cameras("cameras.json", "cameras.json"),
    "cfg_args": Reader("cfg_args", lambda folder: read_cfg_args(folder / "cfg_args")),
    "config.yml": _cameras("run/config.yml", "run"),
    "dataparser_transforms.json": _cameras("run/dataparser_transforms.json", "run"),
    "cfg.yml": _cameras("results/cfg.yml", "results"),
    "region labels": Reader("features/view_00_s.npy", lambda folder: _regions(folder / "features"), (), (of.NPY,)),
    "region embeddings": Reader("features/view_00_f.npy", lambda folder: _regions(folder / "features"), (), (of.NPY,)),
    "regions": Reader("packed/view_00.regions", lambda folder: _regions(folder / "packed"), (),
                      (of.SEALED, of.LABELS), LABELS),
    "regions.json": Reader("packed/regions.json", lambda folder: _regions(folder / "packed")),
    "detections": _detections("view_00.json"),
    "concepts.json": _detections("concepts.json"),
    "field": _field("a.scoup", "bytes.scoup"),
    "field with a splat beside it": _field("linked.scoup"),
    "region sums": Reader(f"a.sums/{view_file('view_00.png')}", _sums, (), (of.SAFETENSORS, of.SEALED)),
    "scene of region sums": Reader("a.sums/scene.safetensors", _sums, (), (of.SAFETENSORS, of.SEALED)),
    "words.npz": _words("words.npz", "single.npz", "alike.npz", containers=(of.ZIP,), memory=TABLES),
    "words.json": _words("words.json"),
    "words.safetensors": _words("words.safetensors", "joined.safetensors", containers=(of.SAFETENSORS,)),
    "archive.json": _archive("archive.json"),
    "scan of an archive": _archive("field.parquet", of.PARQUET),
    "matrix of an archive": _archive("vectors.f16"),
    "labels": Reader("labels/frame_1.json", lambda folder: read_labels(folder / "labels"), (), (), MASKS),
    "png": _picture("a.png", "grey.png", "palette.png", "deep.png", "bits.png", "empty.png", containers=(of.PNG,)),
    "jpg": _picture("a.jpg", "progressive.jpg"),
    "webp": _picture("a.webp", "lossless.webp"),
    **{ending: _picture(f"a.{ending}") for ending in PICTURES if ending in ("bmp", "tif")},
    **{ending[1:]: _splat(f"a{ending}", share=0.1, containers=(of.ZIP,) * (ending == ".sog"))
       for ending in OTHER_SPLATS},
}  # fmt: skip
"""By name. Those that other programs read for us are there where these programs are."""
