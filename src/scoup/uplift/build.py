"""``build``: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from scoup.base.arguments import check_arguments
from scoup.base.errors import ScoupWarning
from scoup.base.progress import Progress, no_progress
from scoup.base.scratch import temporary_folder
from scoup.field.language_field import LanguageField
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.field_info import FieldInfo
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.scene.sanity_checks import sanity_problems
from scoup.uplift import fit
from scoup.uplift.build_settings import BuildSettings, build_settings
from scoup.uplift.provenance import build_record
from scoup.uplift.rasterise import add_views, cameras_with_regions, check_sums
from scoup.uplift.region_codes import RegionCodes, RegionEmbeddings, inputs_digest, learn_region_codes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.things import FoundThings, find_things
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
    check_fit: bool = True,
    progress: Progress = no_progress,
) -> LanguageField:
    """Build a language field (method.md, stages 1 and 2): learn codes per level, rasterise each view once, vote.

    The steps can be called one by one: ``fit_codes``, ``region_sums``, ``vote``, ``LanguageField``. Memory grows with
    the embeddings and codes of all regions, not with the number of views.

    Args:
        gaussians: the trained scene; never changed.
        cameras: posed cameras; those without regions are skipped.
        regions: region maps and embeddings.
        settings: everything that decides the result, or the name of one of ``BUILD_PRESETS``.
        embedding_model: id of the model the embeddings come from, recorded in the field.
        words: the word table that encodes texts in place of this model, recorded in the field.
        geometry_path: file of the Gaussians, recorded in the field.
        backend: name of the backend of rasteriser and vote.
        sums: region sums of these Gaussians to continue from and to keep: only views that they lack are rasterised,
            and the codes are kept beside them. By default they are in a temporary folder.
        check_fit: compare small renders of some views with their photographs first (``uplift/fit.py``), unless the
            sums contain views already.
        progress: called as ``progress(stage, done, total)``.

    Raises:
        InputError: no camera has regions, the cameras see nothing, or the inputs do not fit or are of wrong types.

    Warns:
        ScoupWarning: Gaussians are implausible (``scoup.scene.sanity_checks``), or splat and cameras may not fit.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> field = scoup.build(gaussians, cameras, regions, scoup.BuildSettings(n_atoms=16), check_fit=False)
        >>> field.save("built.scoup")
    """
    check_arguments(
        "build", gaussians=(gaussians, Gaussians), cameras=(cameras, Cameras), regions=(regions, Regions)
    )
    settings = build_settings(settings)
    with ExitStack() as stack:
        if sums is None:
            folder = stack.enter_context(temporary_folder())
            sums = RegionSums.empty(gaussians, regions.levels, settings.raster_preset, path=folder / "sums")
        check_sums(sums, gaussians, regions, settings.raster_preset)
        for problem in sanity_problems(gaussians):
            warnings.warn(problem, ScoupWarning, stacklevel=2)
        views = cameras_with_regions(cameras, regions)
        regions = regions.select([camera.name for camera in views])
        embeddings = RegionEmbeddings.load(regions)
        device = gaussians.device
        if check_fit and not len(sums):
            fit.check_fit(gaussians, views, settings.raster_preset, backend, geometry_path)

        codes = learn_region_codes(sums, embeddings, settings, device, progress)
        digest = inputs_digest(sums.fingerprint, views, embeddings, asdict(settings))
        del embeddings  # the rest needs codes and rounded embeddings only
        add_views(sums, gaussians, views, regions, backend, progress)
        things = thing_table(sums, codes, progress)
        sources = Sources.of(views, embedding_model, words, geometry_path, digest)
        field = vote_field(sums, codes, things, sources, settings, device, backend, progress)
        field.attach(gaussians, known=True)
        return field


@dataclass(frozen=True, eq=False)
class Sources:
    """Origin of a field, as its provenance records it."""

    views: tuple[Camera, ...]
    embedding_model: str = ""
    words: Path | None = None  # the word table that encodes texts, if one does
    geometry_path: Path | None = None  # file of the Gaussians, if known
    digest: str = ""  # of everything the codes depend on, if known (``inputs_digest``)

    @classmethod
    def of(
        cls,
        views: Sequence[Camera],
        embedding_model: str,
        words: str | Path | None,
        geometry_path: str | Path | None,
        digest: str = "",
    ) -> Sources:
        """Return the origin of a field from the arguments of ``build``."""
        table, geometry = (None if path is None else Path(path) for path in (words, geometry_path))
        return cls(tuple(views), embedding_model, table, geometry, digest)


def thing_table(sums: RegionSums, codes: RegionCodes, progress: Progress = no_progress) -> FoundThings | None:
    """Find the things of the views of ``codes``; None if no embeddings are kept with the codes."""
    if not codes.embeddings:
        return None
    return find_things(sums.select(codes.rows[0], codes.rows), codes.embeddings, progress)


def vote_field(
    sums: RegionSums,
    codes: RegionCodes,
    things: FoundThings | None,
    sources: Sources,
    settings: BuildSettings,
    device: torch.device,
    backend: str | None = None,
    progress: Progress = no_progress,
) -> LanguageField:
    """Let all views of ``sources`` vote, the last step of a build; the field has no Gaussians attached."""
    sums = sums.select([view.name for view in sources.views], codes.rows)
    found = vote(
        sums, codes.codes, codes.codebook.to(device), settings.rounds, settings.keep or None, backend=backend,
        progress=progress,
    )  # fmt: skip
    fit.check_coded(found.weights)
    record = build_record(settings, sources.digest, sums, codes, found.sharpness)
    table = None if things is None else things.table
    record |= {} if things is None else things.record(sums.levels)
    model, preset = sources.embedding_model, settings.raster_preset
    info = FieldInfo(sums.levels, model, sums.fingerprint, sums.n_gaussians, preset, record, sources.words)
    origin = {"geometry_path": sources.geometry_path, "cameras": Cameras(sources.views)}
    return LanguageField(found.indices, found.weights, codes.codebook, info, thing_table=table, **origin).to(
        device
    )
