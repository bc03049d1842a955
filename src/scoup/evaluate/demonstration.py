"""The demo: make a scene, write it as files, build a field from the files, query every name, and score the answers."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import mean

from scoup.base.progress import Progress, no_progress
from scoup.evaluate.metrics import bootstrap_interval
from scoup.evaluate.protocols.lerf_ovs import PairScore, SceneScore
from scoup.evaluate.variants import Variant, dense_variant, score_variants, sparse_variant
from scoup.field.language_field import LanguageField
from scoup.io import check_output, load_cameras, load_gaussians, load_regions
from scoup.query.presets import QUERY_PRESETS
from scoup.synthetic.art.layout import Layout
from scoup.synthetic.art.table import TABLE
from scoup.synthetic.folder import write_demo_scene
from scoup.synthetic.scene import EMBEDDING_MODEL, LABELLED_LEVELS, DemoScene, make_demo_scene
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import region_sums
from scoup.uplift.region_codes import RegionCodes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.vote import GaussianCodes, vote

METHOD, ALL_ATOMS, DENSE = "sparse, top-K vote", "sparse, no top-K", "dense 512-d"


@dataclass(frozen=True)
class DemoSettings:
    """How large the demo is.

    Attributes:
        seed: of the scene and of the codebook.
        n_gaussians: of the scene.
        width, height: of its views, in pixels.
        n_building: views the field is built from; a quarter as many are held out for scoring.
        layout: the kind of scene.
    """

    seed: int = 0
    n_gaussians: int = 160_000
    width: int = 480
    height: int = 360
    n_building: int = 24
    layout: Layout = TABLE


@dataclass(frozen=True, eq=False)
class DemoResult:
    """What the demo made and measured.

    Attributes:
        scene: the scene and its truth.
        field: the field built.
        field_path: its file.
        scores: by variant, over every name that the held-out views show.
        bytes_per_gaussian: by variant.
        seconds: by stage, in the order of the stages.
    """

    scene: DemoScene
    field: LanguageField
    field_path: Path
    scores: dict[str, SceneScore]
    bytes_per_gaussian: dict[str, float]
    seconds: dict[str, float]


@dataclass(frozen=True)
class NameRow:
    """The scores of one name over all held-out views that show it.

    Attributes:
        name: the query.
        views: the number of views.
        iou: mean by variant.
        accuracy: share of hits by variant.
        levels: how often the method chose each level, "s", "m", "l".
    """

    name: str
    views: int
    iou: dict[str, float]
    accuracy: dict[str, float]
    levels: dict[str, int]


def run_demo(
    out: Path, settings: DemoSettings, overwrite: bool = False, progress: Progress = no_progress
) -> DemoResult:
    """Run everything. Files go to ``out/scene`` and ``out/demo.scoup``.

    Raises:
        OutputExistsError: the outputs exist and ``overwrite`` is false.
    """
    path = out / "demo.scoup"
    check_output(path, overwrite)
    seconds: dict[str, float] = {}
    with _timed(seconds, "make the scene"):
        scene = make_demo_scene(
            settings.seed,
            settings.n_gaussians,
            settings.width,
            settings.height,
            settings.n_building,
            max(1, settings.n_building // 4),
            settings.layout,
        )
    with _timed(seconds, "write it as files"):
        folder = write_demo_scene(scene, out / "scene", overwrite, progress=progress)
    with _timed(seconds, "read the files"):
        splat = folder / "point_cloud.ply"
        gaussians = load_gaussians(splat)
        cameras = load_cameras(folder)
        regions = load_regions(folder, cameras)
    with _timed(seconds, "rasterise: region sums of all views"):
        sums = region_sums(gaussians, cameras, regions, progress=progress)
    with _timed(seconds, "build the field: coding and vote"):
        field = build(
            gaussians,
            cameras,
            regions,
            settings=BuildSettings(seed=settings.seed),
            embedding_model=EMBEDDING_MODEL,
            geometry_path=splat,
            sums=sums,
            progress=progress,
        )
    field.save(path, overwrite)
    with _timed(seconds, "dense 512-d uplift, to compare"):
        dense = dense_variant(DENSE, sums, [regions.embeddings(level)[0] for level in regions.levels])
    variants = [*_sparse_variants(field, sums), dense]
    frames = [(scene.labelled_frame(camera.name, LABELLED_LEVELS), camera) for camera in scene.held_out]
    labels = sorted({label for frame, _ in frames for label in frame.labels})
    vectors = dict(zip(labels, scene.text_vectors(labels), strict=True))
    with _timed(seconds, "query and score all three"):
        scores = score_variants(
            variants,
            gaussians,
            frames,
            vectors,
            scene.canonical,
            progress=progress,
            preset=QUERY_PRESETS["default"],
        )
    sizes = {variant.name: variant.bytes_per_gaussian for variant in variants}
    return DemoResult(scene, field, path, scores, sizes, seconds)


def _sparse_variants(field: LanguageField, sums: RegionSums) -> list[Variant]:
    """The field, and the same without the top-K step."""
    coded = RegionCodes.kept(sums)
    assert coded is not None  # the build has kept them there
    settings = field.info.provenance["settings"]
    voters = sums.of_views(coded.rows[0], coded.rows)
    everything = vote(voters, coded.codes, coded.codebook, settings["rounds"], None, settings["keep"])
    preset = field.info.raster_preset
    of_field = GaussianCodes(field.code_indices, field.code_weights.float())
    return [
        sparse_variant(METHOD, field.gaussians, of_field, field.codebook, preset),
        sparse_variant(ALL_ATOMS, field.gaussians, everything, field.codebook, preset, all_kept=True),
    ]


def rows_by_name(result: DemoResult) -> list[NameRow]:
    """One row a name, the best IoU of the method first."""
    by_name: dict[str, dict[str, list[PairScore]]] = {}
    for variant, score in result.scores.items():
        for pair in score.pairs:
            by_name.setdefault(pair.label, {}).setdefault(variant, []).append(pair)
    rows = [
        NameRow(
            name,
            len(pairs[METHOD]),
            {variant: mean(pair.iou for pair in of_variant) for variant, of_variant in pairs.items()},
            {variant: mean(bool(pair.hit) for pair in of_variant) for variant, of_variant in pairs.items()},
            dict(Counter(result.field.levels[pair.level] for pair in pairs[METHOD])),
        )
        for name, pairs in by_name.items()
    ]
    return sorted(rows, key=lambda row: -row.iou[METHOD])


def summary(result: DemoResult) -> dict[str, dict[str, float | list[float]]]:
    """By variant: mIoU with its 95 % interval over names, localisation accuracy, bytes a Gaussian."""
    table = {}
    for variant, score in result.scores.items():
        interval = bootstrap_interval(
            [pair.iou for pair in score.pairs], [pair.label for pair in score.pairs]
        )
        table[variant] = {
            "miou": score.miou,
            "interval": [interval.low, interval.high],
            "accuracy": score.accuracy,
            "bytes_per_gaussian": result.bytes_per_gaussian[variant],
        }
    return table


@contextmanager
def _timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    started = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - started
