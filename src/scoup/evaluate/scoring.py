"""One scene of a data set from files to scores: build what is missing, predict into the cache, score by the
protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.base.progress import Progress, no_progress
from scoup.baselines.channels import field_relevancy
from scoup.evaluate.datasets import DataSet, EvalScene
from scoup.evaluate.predictions import PredictionCache, file_digest, prediction_key
from scoup.evaluate.protocols import lerf_ovs, mipnerf360, selection, threed_ovs
from scoup.evaluate.scores import SceneScore
from scoup.field.language_field import LanguageField
from scoup.io import default_preset, load_gaussians, load_regions
from scoup.io.labels import LabelledFrame
from scoup.models.text import TextEncoder
from scoup.query.presets import QueryPreset
from scoup.query.select import select
from scoup.scene.cameras import Camera
from scoup.scene.regions import LEVELS
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.rasterise import resumed


@dataclass(frozen=True, eq=False)
class Asked:
    """The words of a scene.

    Attributes:
        vectors: label -> [D] unit vector.
        canonical: [P, D].
        everyday: [B, D] of everyday words.
    """

    vectors: dict[str, Tensor]
    canonical: Tensor
    everyday: Tensor

    def of(self, labels: tuple[str, ...] | list[str]) -> Tensor:
        """[Q, D]."""
        return torch.stack([self.vectors[label] for label in labels])


def text_source(root: Path, scene: EvalScene, wanted: str | None, default: str) -> str:
    """The table or model that turns labels into vectors: the one wanted, or ``text.npz`` of the scene or of the data
    set, or ``default``."""
    if wanted is not None:
        return wanted.replace("{scene}", scene.name)
    for table in (scene.folder / "text.npz", root / "text.npz"):
        if table.is_file():
            return str(table)
    return default


def encode_labels(scene: EvalScene, source: str, device: str = "cpu") -> Asked:
    """Vectors of every label of a scene, and of the canonical phrases.

    Raises:
        InputError: a table lacks a label or a canonical phrase.
    """
    return encode_words(scene.labels, source, f"which {scene.name} is asked for", device)


def encode_words(words: Sequence[str], source: str, why: str, device: str = "cpu") -> Asked:
    """Vectors of words; ``why`` they are needed, for the error.

    Raises:
        InputError: a table lacks a word or a canonical phrase.
    """
    with TextEncoder.open(source, device=device) as encoder:
        try:
            vectors = encoder.encode(list(words))
            canonical, everyday = encoder.canonical(), encoder.everyday()
        except UnknownNameError as error:
            raise InputError(f"{source}: has no vector for {error.name!r}, {why}") from error
    return Asked(dict(zip(words, vectors, strict=True)), canonical, everyday)


def build_field(
    scene: EvalScene,
    path: Path,
    settings: BuildSettings,
    model: str = "",
    rebuild: bool = False,
    device: str = "cpu",
    progress: Progress = no_progress,
) -> LanguageField:
    """The field of a scene: read where it is built already, else built and saved.

    Raises:
        InputError: a field is there that was built with other settings, and ``rebuild`` is false.
    """
    gaussians = load_gaussians(scene.splat).to(device)
    # Which constants the rasteriser uses follows from the splat.
    settings = replace(settings, raster_preset=default_preset(scene.splat))
    if path.is_file() and not rebuild:
        field = LanguageField.load(path, gaussians).to(device)
        if field.info.provenance.get("settings") != asdict(settings):
            raise InputError(
                f"{path}: was built with other settings; name another folder with --out, or pass --rebuild to "
                "build it again"
            )
        return field
    regions = load_regions(scene.features, scene.cameras)
    checkpoint = path.with_name(path.name + ".partial")
    path.parent.mkdir(parents=True, exist_ok=True)
    sums = resumed(checkpoint, gaussians, regions, settings.raster_preset)
    field = build(
        gaussians,
        scene.cameras,
        regions,
        settings=settings,
        embedding_model=model,
        geometry_path=scene.splat,
        sums=sums,
        progress=progress,
    )
    field.save(path, overwrite=True)
    sums.close()
    checkpoint.unlink(missing_ok=True)
    # What is scored is what is stored, half precision included.
    return LanguageField.load(path, gaussians).to(device)


def map_size(data_set: DataSet, frame: LabelledFrame, camera: Camera) -> tuple[int, int]:
    """(width, height) of the maps a frame is scored at."""
    return (frame.width, frame.height) if data_set.at_label_size else (camera.width, camera.height)


def predict(
    data_set: DataSet,
    scene: EvalScene,
    field: LanguageField,
    source: str,
    asked: Asked,
    cache: PredictionCache,
    progress: Progress = no_progress,
) -> Iterator[tuple[LabelledFrame, Tensor]]:
    """Each labelled frame with its relevancy [S, Q, H, W], labels in its order.

    Args:
        data_set: decides the size of the maps.
        scene, field, asked: what is asked.
        source: digest of the field, for the cache.
        cache: where maps are kept.
        progress: told after each frame.
    """
    progress(f"predict {scene.name}", 0, len(scene.frames))
    for done, (frame, camera) in enumerate(scene.frames, start=1):
        queries = asked.of(frame.labels)
        size = map_size(data_set, frame, camera)
        key = prediction_key(source, camera, frame.labels, queries, asked.canonical, size)
        ask: Callable[[], Tensor] = lambda camera=camera, queries=queries, size=size: field_relevancy(  # noqa: E731
            field, camera, queries, asked.canonical, size=size
        )
        yield frame, cache.get(f"{scene.name}/{frame.name}", key, ask)
        progress(f"predict {scene.name}", done, len(scene.frames))


def score(
    data_set: DataSet,
    scene: str,
    maps: Iterator[tuple[LabelledFrame, Tensor]],
    preset: QueryPreset,
    levels: tuple[str, ...] = LEVELS,
) -> SceneScore:
    """Score the maps of a scene by the rules of its data set."""
    if data_set.name == "3d-ovs":
        return threed_ovs.score_scene(scene, maps, preset, levels)
    if data_set.name == "mipnerf360":
        return mipnerf360.score_scene(scene, maps, preset)
    return lerf_ovs.score_scene(scene, maps, preset)


def score_selection(scene: EvalScene, field: LanguageField, asked: Asked) -> SceneScore:
    """Score a scene by the 3D-selection protocol."""
    rule = selection.VALA_3D
    found = select(field, asked.of(scene.labels), asked.canonical, rule.threshold, rule.neighbours)
    chosen = dict(zip(scene.labels, found, strict=True))
    return selection.score_scene(
        scene.name, field.gaussians, scene.frames, chosen, field.info.raster_preset, rule
    )


def score_field(
    data_set: DataSet,
    scene: EvalScene,
    field_path: Path,
    field: LanguageField,
    asked: Asked,
    preset: QueryPreset,
    cache: PredictionCache,
    progress: Progress = no_progress,
) -> SceneScore:
    """Predict and score a built scene."""
    maps = predict(data_set, scene, field, file_digest(field_path), asked, cache, progress)
    return score(data_set, scene.name, maps, preset, field.levels)
