"""``build``: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import warnings
from pathlib import Path

from torch import Tensor

from scoup import raster
from scoup.base import Progress, ScoupWarning, check_arguments, no_progress, temporary_folder
from scoup.field import Field, FieldInfo, ThingTable
from scoup.scene import Cameras, Gaussians, Regions, sanity_problems
from scoup.uplift import fit
from scoup.uplift.near_plane import scene_preset
from scoup.uplift.provenance import FieldSources, build_record, recorded_model
from scoup.uplift.rasterise import add_views, cameras_with_regions, check_sums, release_memory
from scoup.uplift.region_codes import RegionEmbeddings, code_regions, inputs_digest
from scoup.uplift.settings import BuildSettings, build_settings
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.things import find_things
from scoup.uplift.voting import GaussianCodes, vote


def build(
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    settings: BuildSettings | str = "default",
    *,
    sources: FieldSources = FieldSources(),  # noqa: B008 - frozen
    sums: RegionSums | None = None,
    codebook: Field | None = None,
    progress: Progress = no_progress,
) -> Field:
    """Build a language field (method.md, stages 1 and 2): learn codes per level, rasterise each view once, vote.

    Each step is a function of its own: ``check_scene``, ``code_regions``, ``region_sums``, ``find_things``, ``vote``,
    ``pack``. Memory grows with the embeddings and codes of all regions, not with the number of views.

    Args:
        gaussians: the trained scene; never changed.
        cameras: posed cameras; those without regions are skipped.
        regions: region maps and embeddings.
        settings: everything that decides the result, or the name of one of ``BUILD_PRESETS``.
        sources: models and files that the field names.
        sums: region sums of these Gaussians to continue from: only views that they lack are rasterised. They are not
            changed, but the folder that they are kept in is. By default new ones, in a temporary folder. Views that
            ``cameras`` lack do not vote.
        codebook: an earlier field of the scene, whose codebook codes the regions; by default a new one is learned. Only
            ``k`` of the settings of coding counts then.
        progress: called as ``progress(stage, done, total)``.

    Raises:
        InputError: no camera has regions, the cameras see nothing, or the inputs do not fit or are of wrong types.

    Warns:
        ScoupWarning: Gaussians are implausible (``scoup.scene.sanity_checks``), splat and cameras may not fit, or the
            codebook explains many regions of a view badly.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> field = scoup.build(gaussians, cameras, regions, scoup.BuildSettings(n_atoms=16, check_fit=False))
        >>> field.save("built.scoup")
    """
    check_arguments(
        "build", gaussians=(gaussians, Gaussians), cameras=(cameras, Cameras), regions=(regions, Regions)
    )
    check_arguments("build", codebook=(codebook, (Field, type(None))))
    settings = build_settings(settings, n_atoms=None if codebook is None else codebook.n_atoms)
    model = recorded_model(sources.embedding_model, sources.words)  # a mistake shows before the long work
    with temporary_folder() as folder:
        with_regions = cameras_with_regions(cameras, regions)
        views = Cameras(with_regions)
        prepared = None if sums else raster.prepare_gaussians(gaussians, settings.backend)
        if sums is None:
            preset = scene_preset(gaussians, with_regions, settings.raster_preset, settings.backend, prepared)
            sums = RegionSums.empty(gaussians, regions.levels, preset, folder / "sums", settings.scale)
        check_sums(sums, gaussians, regions, settings)
        regions = regions.select(views.names)
        embeddings = RegionEmbeddings.load(regions)
        _warn_of_problems(gaussians)
        if settings.check_fit and not len(sums):
            fit.check_fit(
                gaussians, with_regions, sums.raster_preset, settings.backend, sources.geometry_path, prepared
            )

        codes = code_regions(embeddings, settings, codebook, gaussians.device, progress)
        inputs = inputs_digest(sums.fingerprint, views, embeddings, settings, codebook)
        rounded = [rows.cpu().half() for rows in embeddings.of_levels]
        del embeddings  # the rest needs codes and rounded embeddings only
        sums = add_views(sums, gaussians, with_regions, regions, settings.backend, progress, prepared)
        del prepared
        sums = sums.select(views.names, codes.rows)
        things = find_things(sums, rounded, progress) if settings.things else None
        release_memory()
        voted = vote(
            sums, codes.codes, codes.codebook.to(gaussians.device), settings.rounds, settings.keep or None,
            settings.backend, progress,
        )  # fmt: skip
        fit.check_coded(voted.weights)
        record = build_record(settings, inputs, sums, codes.reports, voted.sharpness, things)
        info = FieldInfo(
            sums.levels,
            model,
            sums.fingerprint,
            len(gaussians),
            sums.raster_preset,
            record,
            sources.table,
            gaussians.world,
        )
        table = None if things is None else things.table
        return pack(voted, codes.codebook, table, info, gaussians, views, sources.geometry_path)


def check_scene(
    gaussians: Gaussians,
    cameras: Cameras,
    settings: BuildSettings | str = "default",
    splat: str | Path | None = None,
    check_fit: bool = True,
) -> None:
    """Warn of implausible Gaussians, and check that splat and cameras fit (method.md, before a build).

    Args:
        gaussians: the trained scene.
        cameras: of views with photographs; some of them are compared with small renders.
        settings: ``raster_preset``, ``backend`` and ``check_fit`` count.
        splat: the file of the Gaussians, for messages.
        check_fit: whether to compare renders with photographs, if the settings say so, too.

    Raises:
        InputError: splat and cameras do not fit.

    Warns:
        ScoupWarning: Gaussians are implausible (``scoup.scene.sanity_checks``), or splat and cameras may not fit.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> scoup.check_scene(gaussians, cameras, scoup.BuildSettings(check_fit=False))
    """
    settings, views = build_settings(settings), list(cameras)
    _warn_of_problems(gaussians)
    if check_fit and settings.check_fit:
        prepared = raster.prepare_gaussians(gaussians, settings.backend)
        preset = scene_preset(gaussians, views, settings.raster_preset, settings.backend, prepared)
        fit.check_fit(gaussians, views, preset, settings.backend, splat, prepared)


def _warn_of_problems(gaussians: Gaussians) -> None:
    for problem in sanity_problems(gaussians):
        warnings.warn(problem, ScoupWarning, stacklevel=3)


def pack(
    codes: GaussianCodes,
    codebook: Tensor,
    things: ThingTable | None,
    info: FieldInfo,
    gaussians: Gaussians,
    cameras: Cameras | None = None,
    geometry_path: str | Path | None = None,
) -> Field:
    """Return the field of codes and things, on the device of its Gaussians.

    Args:
        codes: from ``vote``, of these Gaussians.
        codebook: [S, L, D] float32.
        things: the table of ``find_things``; without one, the votes of the Gaussians answer alone.
        info: levels, model, fingerprint of the Gaussians, provenance.
        gaussians: the trained scene, as many as ``info`` says; not compared with its fingerprint.
        cameras: of the views that voted.
        geometry_path: file of the Gaussians.

    Raises:
        InputError: shapes, dtypes or values do not fit together.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> coded = scoup.code_regions(scoup.RegionEmbeddings.load(regions), scoup.BuildSettings(n_atoms=8))
        >>> sums = scoup.region_sums(gaussians, cameras, regions)
        >>> info = scoup.FieldInfo(regions.levels, "", sums.fingerprint, len(gaussians))
        >>> scoup.pack(scoup.vote(sums, coded.codes, coded.codebook), coded.codebook, None, info, gaussians).n_atoms
        8
    """
    path = None if geometry_path is None else Path(geometry_path)
    device, parts = gaussians.device, (codes.indices, codes.weights)
    field = Field(
        *parts, codebook.to(device), info, geometry_path=path, cameras=cameras, thing_table=things
    ).to(device)
    field.attach(gaussians, known=True)
    return field
