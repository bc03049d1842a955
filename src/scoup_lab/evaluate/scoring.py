"""One scene of a data set from files to scores: build what is missing, predict into the cache, score by the
protocol."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, replace
from pathlib import Path

from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.locks import complete, locked_output
from scoup.base.progress import Progress, no_progress
from scoup.field.language_field import LanguageField
from scoup.io import default_preset, load_gaussians, load_regions
from scoup.query.neighbours import Neighbourhood
from scoup.query.presets import QueryPreset
from scoup.query.select import select_by_relevancy
from scoup.query.text_vectors import TextVectors
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import LEVELS
from scoup.uplift.build import build
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.checkpoint import checkpoint, continued, save_field
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.data_sets import DataSet, LabelledScene, SceneFiles
from scoup_lab.evaluate.predictions import PredictionCache, prediction_key
from scoup_lab.evaluate.protocols import lerf_ovs, mipnerf360, ref_lerf, selection, threed_ovs
from scoup_lab.evaluate.scores import SceneScore


def build_field(
    scene: SceneFiles,
    path: Path,
    settings: BuildSettings,
    model: str = "",
    rebuild: bool = False,
    device: str = "cpu",
    progress: Progress = no_progress,
    say: Callable[[str], None] = lambda _: None,
) -> LanguageField:
    """The field of a scene: read where it is built already, else built and saved.

    Args:
        say: is given a sentence where an interrupted build is continued.

    Raises:
        InputError: a field is there that was built with other settings, and ``rebuild`` is false.
        OutputInUseError: another process is building it.
    """
    gaussians = load_gaussians(scene.splat).to(device)
    # Which constants the rasteriser uses follows from the splat.
    settings = replace(settings, raster_preset=default_preset(scene.splat))
    complete(path)
    if path.is_file() and not rebuild:
        return _stored(path, gaussians, settings)
    regions = load_regions(scene.features, scene.cameras)
    with locked_output(path, overwrite=True) as output:
        if path.is_file() and not rebuild:  # another process has built it meanwhile
            return _stored(path, gaussians, settings)
        with checkpoint(path, gaussians, regions, settings.raster_preset) as sums:
            if message := continued(sums, len(regions)):
                say(message)
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
            save_field(output, field, sums, keep=False)
    return _stored(path, gaussians, settings)  # what is scored is what is stored, half precision included


def _stored(path: Path, gaussians: Gaussians, settings: BuildSettings) -> LanguageField:
    """A field that is built already, on the device of its Gaussians.

    Raises:
        InputError: it was built with other settings.
    """
    field = LanguageField.load(path, gaussians).to(gaussians.device)
    if field.info.provenance.get("settings") != asdict(settings):
        raise InputError(
            f"{path}: was built with other settings; name another folder with --out, or pass --rebuild to "
            "build it again"
        )
    return field


def predict(
    scene: LabelledScene,
    vectors: TextVectors,
    field: LanguageField,
    digest: str,
    cache: PredictionCache,
    frames: Sequence[str] | None = None,
    progress: Progress = no_progress,
) -> Iterator[tuple[LabelledFrame, Tensor]]:
    """Each labelled frame with its relevancy [S, Q, H, W], labels in its order.

    Args:
        scene: its frames.
        vectors: of the labels.
        field: of the scene.
        digest: of the field, for the cache.
        cache: where maps are kept.
        frames: names of the frames wanted; None for all.
        progress: called after each frame.
    """
    fitted = FittedField(field)
    wanted = [pair for pair in scene.frames if frames is None or pair[0].name in frames]
    progress(f"predict {scene.name}", 0, len(wanted))
    for done, (frame, camera) in enumerate(wanted, start=1):
        queries = vectors.of(frame.labels)
        size = scene.map_size(frame, camera)
        key = prediction_key(digest, camera, frame.labels, queries, vectors.canonical, size)

        def relevancy(camera=camera, queries=queries, size=size) -> Tensor:
            return fitted.relevancy(field.project(camera), queries, vectors.canonical, size)

        yield frame, cache.get(f"{scene.name}/{frame.name}", key, relevancy)
        progress(f"predict {scene.name}", done, len(wanted))


def score_maps(
    data_set: DataSet,
    scene: str,
    maps: Iterable[tuple[LabelledFrame, Tensor]],
    preset: QueryPreset,
    levels: tuple[str, ...] = LEVELS,
) -> SceneScore:
    """Score the maps of a scene by the rules of its data set."""
    if data_set.name == "3d-ovs":
        return threed_ovs.score_scene(scene, maps, preset, levels)
    if data_set.name == "mipnerf360":
        return mipnerf360.score_scene(scene, maps, preset)
    if data_set.name == "ref-lerf":
        return ref_lerf.score_scene(scene, maps, preset)
    return lerf_ovs.score_scene(scene, maps, preset)


def score_selection(
    scene: LabelledScene,
    vectors: TextVectors,
    fitted: FittedMethod,
    gaussians: Gaussians,
    raster_preset: str,
) -> SceneScore:
    """Score a scene by the 3D-selection protocol."""
    rule, coded = selection.VALA_3D, fitted.coded()
    around = Neighbourhood.of(gaussians.means, coded.any(0), rule.neighbours) if rule.neighbours else None
    chosen = {}
    for label, query in zip(vectors.texts, vectors.queries, strict=True):
        relevancy = fitted.gaussian_relevancy(query[None], vectors.canonical)[:, 0]
        chosen[label] = select_by_relevancy(relevancy, coded, around, rule.threshold).mask
    return selection.score_scene(scene.name, gaussians, scene.frames, chosen, raster_preset, rule)
