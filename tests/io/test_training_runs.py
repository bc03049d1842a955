"""Checkpoints of gsplat, nerfstudio, LangSplatV2 and LangSplat's autoencoder, and the folders of trainings: the splat,
and cameras in its frame."""

from __future__ import annotations

import contextlib
import json
import math
import zipfile
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch

from foreign_samples import (
    LangSplatAutoencoder,
    save_langsplatv2,
    save_results,
    save_run,
    save_splatfacto,
    some_similarity,
)
from io_samples import APPLIED, save_checkpoint, save_images, some_cameras, some_gaussians
from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupWarning
from scoup.io import (
    load_cameras,
    load_gaussians,
    save_gaussians,
    splat_source,
    write_transforms,
)
from scoup.io.langsplat_checkpoint import read_langsplat
from scoup.io.regions.langsplat_autoencoder import read_autoencoder
from scoup.io.splats.gsplat_checkpoint import latest_ranks, read_gsplat_checkpoint
from scoup.scene import Cameras, Gaussians
from scoup_lab.data.colmap_model import write_colmap


def save_nerfstudio(given: Gaussians, path: Path, older: bool = False) -> None:
    save_run(path.parents[1], "data/kitchen")
    save_splatfacto(some_gaussians(4, 0), path.with_name("step-000009999.ckpt"), older)
    save_splatfacto(given, path, older)


RUN = "kitchen/splatfacto/2026-01-01_000000"
CHECKPOINTS = {
    "gsplat": (save_checkpoint, "ckpts/ckpt_99_rank0.pt", "."),
    "nerfstudio": (save_nerfstudio, f"{RUN}/nerfstudio_models/step-000029999.ckpt", RUN),
    "older": (partial(save_nerfstudio, older=True), f"{RUN}/nerfstudio_models/step-000029999.ckpt", RUN),
    "LangSplatV2": (save_langsplatv2, "chkpnt10000.pth", None),
}  # fmt: skip


@pytest.mark.parametrize("degree", [0, 2, 3])
@pytest.mark.parametrize("name", CHECKPOINTS)
def test_what_trainers_write_is_read(tmp_path: Path, name: str, degree: int) -> None:
    given, (save, file, folder) = some_gaussians(9, degree), CHECKPOINTS[name]
    given.sh.clamp_(-1, 1)
    saved = save(given, tmp_path / file)
    if folder is None:
        read = read_langsplat(tmp_path / file)
        assert np.array_equal(read.values[:, 0], saved[0].numpy())
        assert read.codebooks is not None
        assert np.array_equal(read.codebooks, saved[1].numpy())
        found = [read.gaussians]
    else:
        places = (tmp_path / file, tmp_path / folder)
        found = [load_gaussians(place) for place in places]
        assert {splat_source(place).preset for place in places} == {"gsplat"}
    for each, (part, tensor) in product(found, given.tensors().items()):
        torch.testing.assert_close(each.tensors()[part], tensor, rtol=1e-5, atol=2e-6)
        if part == "means" or (part == "sh" and name in ("gsplat", "LangSplatV2")):
            assert each.tensors()[part].equal(tensor)


def test_all_ranks_of_the_latest_step_in_order(tmp_path):
    folder = tmp_path / "ckpts"
    for step, rank in ((7, 0), (7, 1), (30, 1), (30, 0), (30, 10)):
        save_checkpoint(some_gaussians(3, seed=step + rank), folder / f"ckpt_{step}_rank{rank}.pt")
    with refuses(MissingFileError):
        read_gsplat_checkpoint(tmp_path)
    (folder / "ckpt_30_rank10.pt").unlink()
    assert [path.name for path in latest_ranks(tmp_path)] == ["ckpt_30_rank0.pt", "ckpt_30_rank1.pt"]
    expected = torch.cat([some_gaussians(3, seed=seed).means for seed in (30, 31)])
    assert torch.equal(read_gsplat_checkpoint(folder).means, expected)
    (folder / "ckpt_30_rank1.pt").unlink()
    with refuses(MissingFileError):  # which step 7 has
        read_gsplat_checkpoint(tmp_path)


@pytest.mark.parametrize(("name", "config", "third", "flat"), [
    ("ckpt_9.pt", "model_type: 2dgs", None, True), ("ckpt_9_rank0.pt", "model_type: 2dgs-inria", None, True),
    ("ckpt_9.pt", "model_type: 3dgs", -1.0, False), ("ckpt_9_rank0.pt", "", -3.0, True), ("ckpt_9.pt", "", 5.0, True),
    ("ckpt_9.pt", "", None, False),
])  # fmt: skip
def test_the_third_scale_of_2dgs(
    tmp_path: Path, name: str, config: str, third: float | None, flat: bool
) -> None:
    given = some_gaussians(60)
    logs = given.scales.log()
    if third is not None:
        logs[:, 2] = third + (torch.rand(60) if third > 0 else 0)
    save_checkpoint(given, tmp_path / "ckpts" / name, scales=logs)
    if config:
        (tmp_path / "cfg.yml").write_text(f"data_dir: data\n{config}\n")
    with warns(ScoupWarning) if flat and not config else contextlib.nullcontext():
        found = load_gaussians(tmp_path).scales
    torch.testing.assert_close(found[:, :2], given.scales[:, :2])
    thin = 3e-4 * given.scales[:, :2].amin(1)
    torch.testing.assert_close(found[:, 2], thin if flat else logs[:, 2].exp())
    for unit in (1, 1000, 0.001):  # as flat in any
        larger, stored = replace(given, means=unit * given.means), logs[:, :2] + math.log(unit)
        save_checkpoint(larger, tmp_path / "ckpts" / name, scales=stored)
        torch.testing.assert_close(load_gaussians(tmp_path).scales[:, 2] / unit, thin, rtol=1e-4, atol=0)


@pytest.mark.parametrize("names", [("scales",), ("opacities",), ("scales", "opacities")])
def test_checkpoints_of_scales_and_opacities_as_they_are(tmp_path: Path, names: tuple[str, ...]) -> None:
    given = some_gaussians(60)
    given.opacities[:2] = torch.tensor([0.02, 0.98])
    stored = {"scales": given.scales.exp(), "opacities": given.opacities.sigmoid()}
    stored = replace(given, **{name: stored[name] for name in names})
    for save, name in ((save_checkpoint, "a.pt"), (save_splatfacto, "step-000000010.ckpt")):
        path = tmp_path / name
        save(stored, path)
        if names != ("scales",):
            with refuses(FileFormatError):
                load_gaussians(path)
        found = load_gaussians(path, activated=True)
        torch.testing.assert_close(found.scales, given.scales)
        torch.testing.assert_close(found.opacities, given.opacities)


def test_rows_that_are_not_finite_take_their_codes_with_them(tmp_path: Path) -> None:
    given = some_gaussians(7, 0)
    given.means[2] = torch.nan
    logits, _ = save_langsplatv2(given, tmp_path / "a.pth")
    with pytest.warns(match="dropped 1 of 7"):
        found = read_langsplat(tmp_path / "a.pth")
    assert np.array_equal(found.values[:, 0], logits.numpy()[[0, 1, 3, 4, 5, 6]])


def test_the_autoencoder_decodes_as_langsplats_does(tmp_path: Path) -> None:
    torch.manual_seed(0)
    network = LangSplatAutoencoder([24, 8, 3], [8, 24, 32], dim=32).eval()
    torch.save(network.state_dict(), tmp_path / "best_ckpt.pth")
    with torch.no_grad():
        codes = network.encode(torch.nn.functional.normalize(torch.randn(9, 32), dim=1))
        expected = network.decode(codes)
    codes[4] = expected[4] = 0
    decode = read_autoencoder(tmp_path / "best_ckpt.pth")
    found = decode(codes.numpy())
    assert found.dtype == np.float32
    assert not found[4].any()
    np.testing.assert_allclose(found, expected.numpy(), atol=1e-6)
    with refuses():
        decode(np.zeros((2, 5)))


def test_archives_that_libraries_refuse(tmp_path: Path) -> None:
    """In words that are theirs: an archive of other content, and one in several parts."""
    with zipfile.ZipFile(tmp_path / "a.pt", "w") as archive:
        archive.writestr("hello.txt", "hello")
    locator = b"PK\6\7" + bytes(12) + (2).to_bytes(4, "little")
    for content in ((tmp_path / "a.pt").read_bytes(), locator + b"PK\5\6" + bytes(18)):
        (tmp_path / "a.pt").write_bytes(content)
        with pytest.raises(FileFormatError, match="cannot be loaded"):
            load_gaussians(tmp_path / "a.pt")


COLMAP = "colmap_dataparser.ColmapDataParserConfig"


def pixels(gaussians: Gaussians, cameras: Cameras) -> torch.Tensor:
    """[V, N, 2] where each mean is seen."""
    return torch.stack([camera.pixels(gaussians.means.double())[0] for camera in cameras])


def moved(gaussians: Gaussians, transform: np.ndarray) -> Gaussians:
    """The means in another world."""
    matrix = torch.from_numpy(transform)
    return replace(gaussians, means=(gaussians.means.double() @ matrix[:3, :3].T + matrix[:3, 3]).float())


@pytest.mark.parametrize("place", ["splat.ply", "exports/splat/splat.ply"])
def test_an_exported_splat_serves_where_there_is_no_checkpoint(tmp_path: Path, place: str) -> None:
    save_run(tmp_path, "data")
    with refuses(MissingFileError):
        load_gaussians(tmp_path)
    save_gaussians(some_gaussians(5), tmp_path / place)
    assert len(load_gaussians(tmp_path)) == 5
    source = splat_source(tmp_path)
    assert (source.path, source.kind.name, source.preset) == (tmp_path / place, "Inria PLY", "gsplat")
    assert splat_source(tmp_path / place).preset == "inria"
    (tmp_path / "nerfstudio_models").mkdir()
    other = {"pipeline": {"_model.field.mlp": torch.zeros(3)}}
    torch.save(other, tmp_path / "nerfstudio_models/step-000000001.ckpt")
    with refuses(FileFormatError):
        load_gaussians(tmp_path)


@pytest.mark.parametrize("parser", ["nerfstudio_dataparser.NerfstudioDataParserConfig", COLMAP])
@pytest.mark.parametrize("absolute", [True, False])
def test_cameras_of_a_run_fit_its_splat(tmp_path: Path, parser: str, absolute: bool) -> None:
    """The splat was trained where dataparser_transforms.json puts the original world, applied_transform included."""
    data, run = tmp_path / "data/kitchen", tmp_path / "outputs/kitchen/splatfacto/1"
    world, gaussians = some_cameras(4), some_gaussians(6)
    transform, scale = some_similarity()
    trained = moved(gaussians, np.diag([scale, scale, scale, 1]) @ transform)
    if parser.startswith("colmap"):
        write_colmap(world, data / "sparse/0")
    else:
        # What ns-process-data did to the cameras is written beside them, and is part of the transform of the run.
        applied, file = np.array(APPLIED), data / "transforms.json"
        data.mkdir(parents=True)
        processed = Cameras(camera.moved(applied[:, :3], applied[:, 3], 1.0) for camera in world)
        write_transforms(processed, file)
        file.write_text(json.dumps({**json.loads(file.read_text()), "applied_transform": APPLIED}))
    save_images(world, data / "images")
    save_run(run, str(data) if absolute else "somewhere/else/data/kitchen", parser)
    found = load_cameras(run)
    assert found.names == world.names
    assert torch.allclose(pixels(trained, found), pixels(gaussians, world), rtol=1e-3, atol=1e-3)
    assert all(camera.image_path is not None for camera in found)


def test_what_a_run_lacks_is_named_with_the_remedy(tmp_path: Path) -> None:
    run = tmp_path / "run"
    save_run(run, "/nowhere/my-kitchen")
    with refuses(MissingFileError):
        load_cameras(run)
    (run / "config.yml").write_text("method_name: splatfacto\n")
    with refuses(MissingFileError):
        load_cameras(run)
    write_colmap(some_cameras(2), tmp_path / "my-kitchen/sparse/0")
    save_run(run, "/nowhere/my-kitchen", COLMAP)
    assert len(load_cameras(run, missing_images="keep")) == 2
    (run / "nerfstudio_models").mkdir()
    (run / "dataparser_transforms.json").unlink()
    with refuses(MissingFileError):
        load_cameras(run)


def oracle(camtoworlds: np.ndarray, points: np.ndarray) -> np.ndarray:
    """gsplat 1.5's examples/datasets: similarity_from_cameras (strict_scaling False, center_method "focus"),
    align_principal_axes, and the turn that follows them in Parser, in its own steps."""
    t, R = camtoworlds[:, :3, 3], camtoworlds[:, :3, :3]
    ups = np.sum(R * np.array([0, -1.0, 0]), axis=-1)
    world_up = np.mean(ups, axis=0)
    world_up /= np.linalg.norm(world_up)
    up_camspace = np.array([0.0, -1.0, 0.0])
    c = (up_camspace * world_up).sum()
    cross = np.cross(world_up, up_camspace)
    skew = np.array([[0.0, -cross[2], cross[1]], [cross[2], 0.0, -cross[0]], [-cross[1], cross[0], 0.0]])
    R_align = np.eye(3) + skew + (skew @ skew) * 1 / (1 + c) if c > -1 else np.diag([-1.0, 1.0, 1.0])
    R = R_align @ R
    fwds = np.sum(R * np.array([0, 0.0, 1.0]), axis=-1)
    t = (R_align @ t[..., None])[..., 0]
    nearest = t + (fwds * -t).sum(-1)[:, None] * fwds
    translate = -np.median(nearest, axis=0)
    transform = np.eye(4)
    transform[:3, 3] = translate
    transform[:3, :3] = R_align
    scale = 1.0 / np.median(np.linalg.norm(t + translate, axis=-1))
    transform[:3, :] *= scale
    points = points @ transform[:3, :3].T + transform[:3, 3]
    centroid = np.median(points, axis=0)
    eigenvalues, eigenvectors = np.linalg.eigh(np.cov(points - centroid, rowvar=False))
    eigenvectors = eigenvectors[:, eigenvalues.argsort()[::-1]]
    if np.linalg.det(eigenvectors) < 0:
        eigenvectors[:, 0] *= -1
    second = np.eye(4)
    second[:3, :3] = eigenvectors.T
    second[:3, 3] = -eigenvectors.T @ centroid
    points = points @ second[:3, :3].T + second[:3, 3]
    transform = second @ transform
    if np.median(points[:, 2]) > np.mean(points[:, 2]):
        transform = np.diag([1.0, -1.0, -1.0, 1.0]) @ transform
    return transform


def garden(
    tmp_path: Path, cameras: Cameras, points: np.ndarray, turn: np.ndarray
) -> tuple[Gaussians, Gaussians]:
    """Gaussians at COLMAP's points, and where the trainer has them if it turns the normalised world."""
    write_colmap(cameras, tmp_path / "garden/sparse/0", (points, np.zeros(points.shape, np.uint8)))
    c2w = np.stack([np.linalg.inv(camera.viewmat.numpy()) for camera in cameras])
    gaussians = replace(some_gaussians(len(points)), means=torch.from_numpy(points).float())
    return gaussians, moved(gaussians, turn @ oracle(c2w, points.astype(np.float32).astype(float)))


def check_results(results: Path, splat: Gaussians, expected: torch.Tensor, bound: float) -> None:
    """The cameras of the results see the splat where the original ones saw the original."""
    save_checkpoint(splat, results / "ckpts/ckpt_29999_rank0.pt")
    cameras = load_cameras(results, missing_images="keep")
    near = expected.abs() < 1e3
    found = pixels(load_gaussians(results), cameras)
    assert torch.allclose(found[near], expected[near], rtol=1e-3, atol=bound)
    assert splat_source(results).preset == "gsplat"


@pytest.mark.parametrize("seed", range(4))
def test_cameras_of_gsplats_results_fit_its_splat(tmp_path: Path, seed: int) -> None:
    world = some_cameras(5, seed=seed)
    points = np.random.default_rng(seed).normal(size=(60, 3)) * [3, 1, 0.4] + 0.2
    gaussians, trained = garden(tmp_path, world, points, np.eye(4))
    for normalise, splat in (("true", trained), (None, trained), ("false", gaussians)):
        save_results(tmp_path / f"results_{normalise}", tmp_path / "garden", normalise)
        check_results(tmp_path / f"results_{normalise}", splat, pixels(gaussians, world), 5e-2)


@pytest.mark.parametrize("turn", [(1.0, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1)])
def test_the_splat_tells_which_side_of_the_axes_is_which(tmp_path: Path, turn: tuple[float, ...]) -> None:
    """Another version of the trainer, or another machine, turns the world by half about an axis."""
    world, generator = some_cameras(5), np.random.default_rng(0)
    points = generator.normal(size=(400, 3)) * [3, 1, 0.4] + generator.exponential(size=(400, 3))
    gaussians, trained = garden(tmp_path, world, points, np.diag([*turn, 1.0]))
    save_results(tmp_path / "results", tmp_path / "garden")
    check_results(tmp_path / "results", trained, pixels(gaussians, world), 0.1)


def test_results_without_checkpoints_have_an_exported_splat(tmp_path: Path) -> None:
    results = tmp_path / "results"
    save_results(results, tmp_path / "nowhere")
    (results / "ply").mkdir()
    with refuses(MissingFileError):
        load_gaussians(results)
    for step, count in ((6999, 3), (29999, 5)):
        save_gaussians(some_gaussians(count), results / f"ply/point_cloud_{step}.ply")
    assert len(load_gaussians(results)) == 5
    assert splat_source(results).preset == "gsplat"
    with refuses(MissingFileError):
        load_cameras(results)
    (results / "cfg.yml").write_text("result_dir: results\n")
    with refuses(MissingFileError):
        load_cameras(results)


def test_a_world_without_points_is_refused(tmp_path: Path) -> None:
    points = np.zeros((2, 3)), np.zeros((2, 3), np.uint8)
    write_colmap(some_cameras(3), tmp_path / "garden/sparse/0", points)
    save_results(tmp_path / "results", tmp_path / "garden")
    (tmp_path / "results/ckpts").mkdir()
    with refuses(FileFormatError):
        load_cameras(tmp_path / "results", missing_images="keep")


def test_the_data_of_a_run_may_be_a_file_or_not_named(tmp_path: Path) -> None:
    run = tmp_path / "run"
    write_transforms(some_cameras(3), tmp_path / "data/transforms.json")
    save_run(run, str(tmp_path / "data/transforms.json"))
    assert len(load_cameras(run, missing_images="keep")) == 3
    kind = "data: !!python/object/apply:pathlib.PosixPath\n"
    for text in (kind + "other: 1\n", kind + "- /\n- nowhere"):
        (run / "config.yml").write_text(text)
        with refuses(MissingFileError):
            load_cameras(run)


def test_the_data_may_lie_in_the_folder_of_the_training(tmp_path: Path) -> None:
    points = np.random.default_rng(0).normal(size=(20, 3))
    write_colmap(some_cameras(3), tmp_path / "sparse/0", (points, np.zeros((20, 3), np.uint8)))
    (tmp_path / "ckpts").mkdir()
    for save in (lambda: save_results(tmp_path, tmp_path), lambda: save_run(tmp_path, str(tmp_path), COLMAP)):
        save()
        assert len(load_cameras(tmp_path, missing_images="keep")) == 3
        (tmp_path / "cfg.yml").unlink(missing_ok=True)


def test_other_data_of_the_same_name_are_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder below the current one that has the name, but no cameras, is not what the training saw."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    write_colmap(some_cameras(2), tmp_path / "project/data/sparse/0")
    save_run(tmp_path / "project/run", "data", COLMAP)
    assert len(load_cameras(tmp_path / "project/run", missing_images="keep")) == 2


@pytest.mark.parametrize("named", ["(" * 5000, "a/\0b", "x/" * 3000])
def test_data_of_a_name_that_no_system_takes(tmp_path: Path, named: str) -> None:
    (tmp_path / "cfg.yml").write_text(f"data_dir: {named}\n")
    (tmp_path / "ckpts").mkdir()
    with pytest.raises(MissingFileError, match="not on this machine"):
        load_cameras(tmp_path)
