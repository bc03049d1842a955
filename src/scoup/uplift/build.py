"""``build``: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import hashlib
import warnings
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path

from scoup.base.arguments import check_arguments
from scoup.base.errors import ScoupWarning
from scoup.base.native import release_memory
from scoup.base.progress import Progress, no_progress
from scoup.base.scratch import temporary_folder
from scoup.field import Field
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.field_info import FieldInfo
from scoup.scene.gaussians import Gaussians
from scoup.scene.names import Detections
from scoup.scene.regions import Regions
from scoup.scene.sanity_checks import sanity_problems
from scoup.uplift import fit
from scoup.uplift.build_settings import BuildSettings, build_settings
from scoup.uplift.naming import name_things
from scoup.uplift.provenance import build_record, recorded_model
from scoup.uplift.rasterise import add_views, cameras_with_regions, check_sums
from scoup.uplift.region_codes import RegionEmbeddings, code_regions, inputs_digest, learn_region_codes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.things import find_things
from scoup.uplift.vote import vote


def build(  # noqa: PLR0913  the public face: each keyword is one choice of the user
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    settings: BuildSettings | str = "default",
    *,
    embedding_model: str = "",
    words: str | Path | None = None,
    geometry_path: str | Path | None = None,
    backend: str | None = None,
    sums: RegionSums | None = None,
    codebook: Field | None = None,
    concepts: tuple[Sequence[str], Mapping[str, Detections]] | None = None,
    check_fit: bool = True,
    progress: Progress = no_progress,
) -> Field:
    """Build a language field (method.md, stages 1 and 2): learn codes per level, rasterise each view once, vote.

    The steps can be called one by one: ``fit_codes``, ``region_sums``, ``find_things``, ``vote``, ``LanguageField``.
    Memory grows with the embeddings and codes of all regions, not with the number of views.

    Args:
        gaussians: the trained scene; never changed.
        cameras: posed cameras; those without regions are skipped.
        regions: region maps and embeddings.
        settings: everything that decides the result, or the name of one of ``BUILD_PRESETS``.
        embedding_model: id of the model the embeddings come from, recorded in the field; by default the one that the
            word table names.
        words: the word table that encodes texts in place of this model, recorded in the field.
        geometry_path: file of the Gaussians, recorded in the field.
        backend: name of the backend of rasteriser and vote.
        sums: region sums of these Gaussians to continue from and to keep: only views that they lack are rasterised.
            By default they are in a temporary folder. Views that ``cameras`` lack do not vote.
        codebook: an earlier field of the scene, whose codebook codes the regions; by default a new one is learned. Only
            ``k`` of the settings of coding counts then.
        concepts: texts, and view -> what a model found of them in its photograph (``scoup.extract.extract_concepts``):
            things are named by it.
        check_fit: compare small renders of some views with their photographs first (``uplift/fit.py``), unless the
            sums contain views already.
        progress: called as ``progress(stage, done, total)``.

    Raises:
        InputError: no camera has regions, the cameras see nothing, or the inputs do not fit or are of wrong types.

    Warns:
        ScoupWarning: Gaussians are implausible (``scoup.scene.sanity_checks``), splat and cameras may not fit, or the
            codebook explains many regions of a view badly.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> field = scoup.build(gaussians, cameras, regions, scoup.BuildSettings(n_atoms=16), check_fit=False)
        >>> field.save("built.scoup")
    """
    check_arguments(
        "build", gaussians=(gaussians, Gaussians), cameras=(cameras, Cameras), regions=(regions, Regions)
    )
    check_arguments("build", codebook=(codebook, (Field, type(None))))
    settings, model = build_settings(settings), recorded_model(embedding_model, words)
    if codebook is not None:
        settings = replace(settings, n_atoms=codebook.n_atoms)
    device = gaussians.device
    with ExitStack() as stack:
        if sums is None:
            folder = stack.enter_context(temporary_folder())
            sums = RegionSums.empty(
                gaussians, regions.levels, settings.raster_preset, folder / "sums", settings.scale
            )
        check_sums(sums, gaussians, regions, settings.raster_preset, settings.scale)
        views = cameras_with_regions(cameras, regions)
        regions = regions.select([camera.name for camera in views])
        embeddings = RegionEmbeddings.load(regions)
        check_scene(
            gaussians, views, settings.raster_preset, backend, geometry_path, check_fit and not len(sums)
        )

        if codebook is None:
            codes = learn_region_codes(embeddings, settings, device, progress)
        else:
            codes = code_regions(embeddings, codebook, settings.k, device)
        digest = inputs_digest(sums.fingerprint, views, embeddings, _decisive(settings, codebook))
        halves = [rows.cpu().half() for rows in embeddings.of_levels]
        del embeddings  # the rest needs codes and rounded embeddings only
        add_views(sums, gaussians, views, regions, backend, progress)
        sums = sums.select([view.name for view in views], codes.rows)
        things = find_things(sums, halves, progress) if settings.things else None
        release_memory()
        gaussian_codes = vote(
            sums, codes.codes, codes.codebook.to(device), settings.rounds, settings.keep or None,
            backend=backend, progress=progress,
        )  # fmt: skip
        fit.check_coded(gaussian_codes.weights)
        record = build_record(settings, digest, sums, codes.reports, gaussian_codes.sharpness)
        if things is not None:
            record["strays"] = dict(zip(sums.levels, things.strays, strict=False))
        thing_table = None if things is None else things.table
        if thing_table is not None and concepts is not None:
            texts, found = concepts
            seen = [(view, found[view.name]) for view in views if view.name in found]
            if seen:
                names = name_things(gaussians, thing_table, seen, texts, settings.raster_preset, backend)
                thing_table = replace(thing_table, names=names)
        table, geometry = (None if path is None else Path(path) for path in (words, geometry_path))
        field = Field(
            gaussian_codes.indices,
            gaussian_codes.weights,
            codes.codebook.to(device),
            FieldInfo(
                sums.levels,
                model,
                sums.fingerprint,
                len(gaussians),
                settings.raster_preset,
                record,
                table,
            ),
            geometry_path=geometry,
            cameras=Cameras(views),
            thing_table=thing_table,
        ).to(device)
        field.attach(gaussians, known=True)
        return field


def check_scene(
    gaussians: Gaussians,
    views: Sequence[Camera],
    raster_preset: str,
    backend: str | None = None,
    geometry_path: str | Path | None = None,
    check_fit: bool = True,
) -> None:
    """Warn of implausible Gaussians, and check that splat and cameras fit (``uplift/fit.py``)."""
    for problem in sanity_problems(gaussians):
        warnings.warn(problem, ScoupWarning, stacklevel=3)
    if check_fit:
        fit.check_fit(gaussians, views, raster_preset, backend, geometry_path)


def _decisive(settings: BuildSettings, codebook: Field | None) -> dict[str, object]:
    """Return everything that decides the result but the inputs, as JSON values."""
    if codebook is None:
        return asdict(settings)
    digest = hashlib.sha256(codebook.codebook.cpu().contiguous().numpy().data)
    return {**asdict(settings), "codebook": digest.hexdigest()}
