"""One small valid file or more of every format that is read, in one folder."""

from __future__ import annotations

import gzip
import importlib.util
import json
from dataclasses import replace
from pathlib import Path
from shutil import copytree

import numpy as np
import torch
from safetensors.torch import save_file
from tests.field_files import small_field
from tests.foreign_samples import (
    LangSplatAutoencoder,
    save_langsplatv2,
    save_results,
    save_run,
    save_splatfacto,
)
from tests.gltf_samples import spz_in_gltf
from tests.io_samples import (
    ply_file,
    save_checkpoint,
    save_compressed_ply,
    save_images,
    save_langsplat,
    save_spz,
    some_cameras,
    some_gaussians,
    some_regions,
    stored_view,
    write_colmap_text,
    write_inria_cameras,
)
from tests.support import small_scene

from scoup.io import (
    DetectionStore,
    PlyTable,
    RegionManifest,
    save_gaussians,
    save_png,
    write_gltf,
    write_transforms,
)
from scoup.io.regions import compact
from scoup.io.regions.manifest import write_manifest
from scoup.io.splats.formats import FORMATS
from scoup.models import WordTable
from scoup.query import LanguageField
from scoup.scene import Detections, Gaussians
from scoup.uplift import region_sums
from scoup_lab.data.colmap_model import write_colmap
from scoup_lab.data.labelled_points import LabelledPoints, write_labelled_ply

SIZE = (8, 6)  # of label maps and photographs
MANY = 2000  # Gaussians of the larger files
KEPT = Path(__file__).parents[1] / "frozen" / "formats"
PICTURES = {"png": {}, "jpg": {"quality": 80}, "webp": {}, "bmp": {}, "tif": {"compression": "tiff_lzw"}}
"""Endings of photographs, and how Pillow is to write them."""


_HAVE_SAMPLES = (".ply", ".compressed.ply", ".splat", ".spz", ".glb", ".gltf")
OTHER_SPLATS = [
    ending
    for kind in FORMATS.values()
    if kind.read and kind.write
    if kind.extra != "splats" or importlib.util.find_spec("gaussforge") is not None
    for ending in kind.endings
    if ending not in _HAVE_SAMPLES
]
"""Endings of the table of splat formats for which nothing else writes a sample."""


def write_samples(folder: Path) -> None:
    """Write all of them."""
    for write in (
        _write_splats,
        _write_checkpoints,
        _write_cameras,
        _write_regions,
        _write_fields,
        _write_words,
    ):
        write(folder)
    _write_pictures(folder / "pictures")
    copytree(KEPT / "archive", folder / "archive")


def _write_splats(folder: Path) -> None:
    few = some_gaussians(4)
    for name in ("a.ply", "a.splat", "a.spz"):
        save_gaussians(few, folder / name)
        save_gaussians(some_gaussians(MANY, degree=0), folder / f"many{Path(name).suffix}")
    # Of Gaussians that are all alike nothing shrinks further, so nothing grows more when it is read.
    one = some_gaussians(1, degree=0)
    alike = Gaussians(*(part.expand(200_000, *part.shape[1:]) for part in one.tensors().values()))
    save_gaussians(alike, folder / "alike.spz")
    save_spz(alike, folder / "alike4.spz", 4)
    for version in (1, 2, 4):
        save_spz(few, folder / f"version{version}.spz", version)
    save_spz(some_gaussians(MANY, degree=4), folder / "many4.spz", 4)
    (folder / "a.unpacked").write_bytes(gzip.decompress((folder / "a.spz").read_bytes()))
    ids = torch.tensor([0, 1, -1, 1])
    for ending in ("glb", "gltf"):
        write_gltf(few, folder / f"a.{ending}", ids=ids, names=("chair", "table"))
        write_gltf(some_gaussians(MANY, degree=0), folder / f"many.{ending}")
    spz_in_gltf(folder, few)
    for name, gaussians in (("", few), ("_many", some_gaussians(MANY, degree=0))):
        save_compressed_ply(folder / f"packed{name}.ply", count=len(gaussians))
        _write_ascii_ply(folder / f"ascii{name}.ply", gaussians)
    for ending in OTHER_SPLATS:
        save_gaussians(few, folder / f"a{ending}")
    write_labelled_ply(LabelledPoints(few.means, torch.arange(4)), folder / "labelled.ply")


def _write_ascii_ply(path: Path, gaussians: Gaussians) -> None:
    rows = PlyTable.of(gaussians).rows
    ply_file(path, {name: rows[name] for name in rows.dtype.names or ()}, "ascii")


def _write_checkpoints(folder: Path) -> None:
    few = some_gaussians(4)
    save_checkpoint(few, folder / "ckpts" / "ckpt_1_rank0.pt")
    save_checkpoint(some_gaussians(3, degree=0), folder / "other.pt")
    save_splatfacto(few, folder / "run" / "nerfstudio_models" / "step-000000009.ckpt")
    save_splatfacto(few, folder / "older.ckpt", older=True)
    save_langsplatv2(few, folder / "v2.pth")
    torch.save(LangSplatAutoencoder([4, 3], [4, 8], dim=8).state_dict(), folder / "best_ckpt.pth")


def _write_cameras(folder: Path) -> None:
    cameras, means = some_cameras(2), some_gaussians(3).means.numpy()
    points = (means.astype(float), (means > 0).astype("u1"))
    write_colmap(cameras, folder / "scene" / "sparse" / "0", points)
    write_colmap_text(cameras, folder / "text" / "sparse", points)
    save_images(cameras, folder / "scene" / "images")
    write_transforms(cameras, folder / "transforms.json")
    write_inria_cameras(cameras, folder / "cameras.json")
    (folder / "cfg_args").write_text("Namespace(sh_degree=3, source_path='a', eval=False)")
    save_run(folder / "run", "scene", "colmap_dataparser.ColmapDataParserConfig")
    save_results(folder / "results", Path("scene"))
    (folder / "results" / "ckpts").mkdir()


def _write_regions(folder: Path) -> None:
    regions = some_regions(some_cameras(1, *SIZE))
    save_langsplat(regions, folder / "features")
    packed, manifest = folder / "packed", RegionManifest.of("a/model", {"least": 0.5}, 16)
    write_manifest(packed, manifest)
    view = stored_view(regions, regions.view_names[0], "<f2", "0" * 64)
    compact.write_view(packed, "view_00", view, manifest.fingerprint)
    store = DetectionStore.new(folder / "concepts", ("mug", "kettle"), {"model": "a"})
    store.begin()
    box = torch.tensor([[1.0, 2.0, 5.0, 4.0]])
    store.write("view_00.png", "0", Detections(torch.tensor([1]), torch.tensor([0.5]), box, SIZE))


def _write_fields(folder: Path) -> None:
    """Write fields with their geometry, one whose geometry is a file beside it, and region sums."""
    field = small_field()
    field.geometry_path = None
    field.save(folder / "a.scoup", embed_geometry=True)
    field.save(folder / "bytes.scoup", embed_geometry=True, weight_bits=8)
    stored = PlyTable.of(field.gaussians).gaussians()[0]
    save_gaussians(stored, folder / "linked.ply")
    info = replace(field.info, fingerprint=stored.fingerprint())
    codes = (field.code_indices, field.code_weights, field.codebook)
    linked = LanguageField(*codes, info, stored, folder / "linked.ply")
    linked.save(folder / "linked.scoup", embed_geometry=False)
    gaussians, cameras, regions = small_scene(count=40, views=2, width=16, height=12)
    region_sums(gaussians, cameras, regions, path=folder / "a.sums")


def _write_words(folder: Path) -> None:
    """Write tables of words, and labels."""
    vectors, names = torch.arange(1.0, 13.0).view(3, 4), ["cup", "chair", "table"]
    WordTable.save(folder / "words.npz", names, vectors, model="a/model")
    each = dict(zip(names, vectors.clone(), strict=True))
    np.savez_compressed(folder / "single.npz", **{name: row.numpy() for name, row in each.items()})  # pyright: ignore[reportArgumentType]
    alike = np.ones((3, 500_000), np.float32)
    np.savez_compressed(folder / "alike.npz", names=np.array(names), vectors=alike)
    rows = {name: row.tolist() for name, row in each.items()}
    (folder / "words.json").write_text(json.dumps({"model": "a/model", **rows}))
    save_file(each, folder / "words.safetensors", {"model": "a/model"})
    save_file({"vectors": vectors}, folder / "joined.safetensors", {"names": json.dumps(names)})
    things = [
        {"category": "cup", "segmentation": [[1, 1], [9, 2.5], [5, 8]], "bbox": [1, 1, 9, 8]},
        {"category": "chair", "segmentation": [[3, 3], [4, 4]]},
    ]
    (folder / "labels").mkdir()
    content = {"info": {"name": "frame_1.jpg", "width": 32, "height": 24}, "objects": things}
    (folder / "labels" / "frame_1.json").write_text(json.dumps(content))


def _write_pictures(folder: Path) -> None:
    """Write photographs of every ending, and masks: grey, of one bit, and with a palette."""
    from PIL import Image

    folder.mkdir()
    width, height = 32, 24
    slope = np.add.outer(np.arange(height), np.arange(width))
    pixels = np.stack([slope * 4, slope * 2, 255 - slope], axis=-1).astype(np.uint8)
    for ending, more in PICTURES.items():
        Image.fromarray(pixels).save(folder / f"a.{ending}", **more)
    Image.fromarray(pixels).save(folder / "progressive.jpg", progressive=True)
    Image.fromarray(pixels).save(folder / "lossless.webp", lossless=True)
    save_png(slope % 2 == 0, folder / "grey.png")
    Image.fromarray(pixels).convert("P").save(folder / "palette.png")
    Image.fromarray(slope.astype(np.uint16) * 700).save(folder / "deep.png")
    Image.fromarray(slope % 3 == 0).save(folder / "bits.png")
    Image.fromarray(np.zeros((2000, 2000), bool)).save(folder / "empty.png")
