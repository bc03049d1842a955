"""Output folders of nerfstudio and gsplat: the splat, and cameras in its frame, by naming the folder."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from foreign_samples import save_results, save_run, some_similarity
from io_samples import save_checkpoint, save_images, some_cameras, some_gaussians
from messages import refuses
from scoup.base import FileFormatError, MissingFileError
from scoup.io import (
    load_cameras,
    load_gaussians,
    save_gaussians,
    splat_source,
    write_colmap,
    write_transforms,
)
from scoup.scene import Cameras, Gaussians


def pixels(gaussians: Gaussians, cameras: Cameras) -> torch.Tensor:
    """[V, N, 2] where each mean is seen."""
    seen = []
    for camera in cameras:
        points = gaussians.means.double() @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        image = points @ camera.K.T
        seen.append(image[:, :2] / image[:, 2:])
    return torch.stack(seen)


def moved(gaussians: Gaussians, transform: np.ndarray) -> Gaussians:
    """The means in another world."""
    matrix = torch.from_numpy(transform)
    means = (gaussians.means.double() @ matrix[:3, :3].T + matrix[:3, 3]).float()
    return Gaussians(means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.sh)


def test_an_exported_splat_serves_where_there_is_no_checkpoint(tmp_path: Path) -> None:
    run = tmp_path / "run"
    save_run(run, "data")
    with refuses(MissingFileError):
        load_gaussians(run)
    (run / "exports" / "splat").mkdir(parents=True)
    save_gaussians(some_gaussians(5), run / "exports" / "splat" / "splat.ply")
    assert len(load_gaussians(run)) == 5
    assert splat_source(run).preset == "gsplat"
    (run / "nerfstudio_models").mkdir()
    other = {"pipeline": {"_model.field.mlp": torch.zeros(3)}}
    torch.save(other, run / "nerfstudio_models/step-000000001.ckpt")
    with refuses(FileFormatError):
        load_gaussians(run)


@pytest.mark.parametrize(
    "parser", ["nerfstudio_dataparser.NerfstudioDataParserConfig", "colmap_dataparser.ColmapDataParserConfig"]
)
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
        applied = np.array([[0, 1, 0, 0], [1, 0, 0, 0], [0, 0, -1, 0.0]])
        (data / "x").mkdir(parents=True)
        processed = Cameras(camera.moved(applied[:, :3], applied[:, 3], 1.0) for camera in world)
        write_transforms(processed, data / "transforms.json")
        content = json.loads((data / "transforms.json").read_text())
        (data / "transforms.json").write_text(json.dumps({**content, "applied_transform": applied.tolist()}))
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
    save_run(run, "/nowhere/my-kitchen", "colmap_dataparser.ColmapDataParserConfig")
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
    save_results(tmp_path, tmp_path)
    (tmp_path / "ckpts").mkdir()
    assert len(load_cameras(tmp_path, missing_images="keep")) == 3
    (tmp_path / "cfg.yml").unlink()
    save_run(tmp_path, str(tmp_path), "colmap_dataparser.ColmapDataParserConfig")
    assert len(load_cameras(tmp_path, missing_images="keep")) == 3


def test_other_data_of_the_same_name_are_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder below the current one that has the name, but no cameras, is not what the training saw."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    write_colmap(some_cameras(2), tmp_path / "project/data/sparse/0")
    save_run(tmp_path / "project/run", "data", "colmap_dataparser.ColmapDataParserConfig")
    assert len(load_cameras(tmp_path / "project/run", missing_images="keep")) == 2


@pytest.mark.parametrize("named", ["(" * 5000, "a/\0b", "x/" * 3000])
def test_data_of_a_name_that_no_system_takes(tmp_path: Path, named: str) -> None:
    (tmp_path / "cfg.yml").write_text(f"data_dir: {named}\n")
    (tmp_path / "ckpts").mkdir()
    with pytest.raises(MissingFileError, match="not on this machine"):
        load_cameras(tmp_path)
