"""``update``: views added to, changed in or removed from a field whose region sums are kept."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch

from scoup.base.arguments import check_arguments
from scoup.base.errors import InputError, ScoupWarning
from scoup.base.progress import Progress, no_progress
from scoup.field.language_field import LanguageField
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.regions import Regions
from scoup.uplift import fit
from scoup.uplift.build import thing_table
from scoup.uplift.new_views import MANY, CodedView, code_view, explained_thresholds, view_embeddings
from scoup.uplift.rasterise import add_views
from scoup.uplift.region_codes import RegionCodes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.vote import GaussianCodes, vote

MOST_UPDATES = 100
"""Updates that a field records; earlier ones are counted."""


def update(  # noqa: PLR0913  the public face: each keyword is one choice of the user
    field: LanguageField,
    sums: RegionSums,
    add: Iterable[Camera] = (),
    regions: Regions | None = None,
    remove: Sequence[str] = (),
    new_atoms: int = 0,
    *,
    backend: str | None = None,
    check_fit: bool = True,
    progress: Progress = no_progress,
) -> LanguageField:
    """Add, change or remove views of a field: only these are rasterised, then all views vote again.

    The field's atoms and the codes of the other views' regions stay. Objects that no earlier view showed may have no
    atoms; ``new_atoms`` adds some for the regions that the codebook explains badly (``Codebook.extended``). Levels
    that need fewer than the others are padded with zero atoms, which no code uses.

    Args:
        field: built with these sums; not changed. Its geometry is read only if a view is added.
        sums: kept region sums of the field; changed.
        add: cameras of new views, and of views whose regions have changed since.
        regions: of these cameras, with the field's levels.
        remove: names of views to remove.
        new_atoms: most atoms to add per level and view. 0 warns if more than 30 % of a view's regions are badly
            explained.
        backend: of rasteriser and vote.
        check_fit: compare small renders of the views to add with their photographs first, as ``build`` does.
        progress: called for the stages "region sums" and "vote".

    Returns:
        A new field.

    Raises:
        InputError: the sums are not those of the field, a view to remove is missing, no view would be left, levels or
            embeddings do not fit, ``new_atoms`` is negative or makes more than 65536 atoms, or the field does not
            record how well its codebook explains regions; or the field's Gaussians and the cameras to add do not fit.

    Warns:
        ScoupWarning: the codebook explains many regions badly, or Gaussians and cameras may not fit.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> regions = scoup.load_regions("scene", cameras)
        >>> sums = scoup.region_sums(gaussians, cameras, regions)
        >>> field = scoup.build(gaussians, cameras, regions, sums=sums, check_fit=False)
        >>> fewer = scoup.update(field, sums, remove=["view_03.png"])
        >>> len(sums)
        3
    """
    check_arguments("update", field=(field, LanguageField), sums=(sums, RegionSums))
    coded, add = field_codes(field, sums), list(add)
    if regions is None:
        if add:
            raise InputError(
                "update: the views to add have no regions; pass regions=load_regions(folder, cameras)"
            )
        regions = Regions.from_maps({})
    if check_fit and add:
        fit.check_fit(field.gaussians, add, field.info.raster_preset, backend, field.geometry_path)
    changed, coded = _code_new_views(field, coded, add, regions, new_atoms)
    for name in remove:
        coded = coded.without_view(name)
    if not coded.rows[0]:
        raise InputError("no view would be left to vote; keep at least one")
    if add:
        add_views(sums, field.gaussians, add, regions, backend, progress)
    for name in remove:
        sums.remove(name)

    device = field.codebook.device
    found = vote_again(field, sums, coded, backend, progress)
    things = thing_table(sums, coded, progress=progress)
    coded.compact().save(sums, "")
    provenance = dict(field.info.provenance)
    provenance["views"] = list(coded.rows[0])
    provenance |= append_update(provenance, _record(add, changed, remove, field.levels))
    provenance |= {} if things is None else things.record(field.levels)
    if found.sharpness is not None:
        provenance["sharpness"] = found.sharpness.tolist()
    updated = LanguageField(
        found.indices,
        found.weights,
        coded.codebook,
        replace(field.info, provenance=provenance),
        geometry_path=field.geometry_path,
        cameras=_cameras(field.cameras, add, remove),
        thing_table=None if things is None else things.table,
    ).to(device)
    updated.keep_encoder_of(field)
    if field.has_geometry:
        updated.attach(field.gaussians, known=True)
    return updated


def vote_again(
    field: LanguageField,
    sums: RegionSums,
    coded: RegionCodes,
    backend: str | None = None,
    progress: Progress = no_progress,
) -> GaussianCodes:
    """Let all views of ``coded`` vote, with the settings of the field's build."""
    settings = _Recorded.read(field)
    voters = sums.select(coded.rows[0], coded.rows)
    return vote(
        voters, coded.codes, coded.codebook.to(field.codebook.device), settings.rounds, settings.keep or None,
        settings.keep or settings.k, backend, progress,
    )  # fmt: skip


def append_update(provenance: Mapping[str, Any], record: dict[str, Any]) -> dict[str, Any]:
    """Return the entries of a field's provenance about updates after one more: the newest, and the number before."""
    updates = [*provenance.get("updates", []), record]
    left_out = max(0, len(updates) - MOST_UPDATES)
    known = {"updates": updates[left_out:]}
    earlier = provenance.get("earlier_updates", 0) + left_out
    return {**known, "earlier_updates": earlier} if earlier else known


@dataclass(frozen=True)
class _Recorded:
    """Settings of the build that a field records."""

    k: int
    keep: int
    rounds: int

    @classmethod
    def read(cls, field: LanguageField) -> _Recorded:
        settings = field.info.provenance.get("settings", {})
        kept = field.code_indices.shape[2]
        return cls(
            int(settings.get("k", kept)),
            int(settings.get("keep", kept)),
            int(settings.get("rounds", 1)),
        )


def _code_new_views(
    field: LanguageField, coded: RegionCodes, cameras: Sequence[Camera], regions: Regions, new_atoms: int
) -> tuple[list[CodedView], RegionCodes]:
    """Code the regions of views, and add them to ``coded``; warns if the codebook explains many of them badly."""
    found: list[CodedView] = []
    recorded = _Recorded.read(field)
    for name in (camera.name for camera in cameras):
        rows = view_embeddings(name, regions, field.levels, field.dim)
        thresholds = explained_thresholds(field.info.provenance, field.levels)
        view = code_view(coded.codebook, rows, recorded.k, thresholds, new_atoms)
        _warn_of_badly_explained(name, view, new_atoms)
        coded = coded.with_view(name, view.codes, view.codebook, rows)
        found.append(view)
    return found, coded


def field_codes(field: LanguageField, sums: RegionSums) -> RegionCodes:
    """Return the codes of a field's regions, kept beside its region sums; an InputError for sums of another field."""
    coded = RegionCodes.load(sums)
    if sums.fingerprint != field.info.fingerprint or sums.levels != field.levels:
        raise InputError(f"{sums.path or 'the region sums'}: are of another scene than the field")
    if coded is None or not torch.equal(coded.codebook, field.codebook.cpu()):
        raise InputError(
            f"{sums.path or 'the region sums'}: contain no codes of this field; build it with kept `sums`, and use "
            "those"
        )
    if sorted(field.info.provenance.get("views", coded.rows[0])) != sorted(coded.rows[0]):
        raise InputError(
            f"{sums.path or 'the region sums'}: contain other views than the field, one of the two is older; use the "
            "sums written beside it, or build the field again with kept `sums`"
        )
    return coded


def _warn_of_badly_explained(view_name: str, coded: CodedView, new_atoms: int) -> None:
    share = (coded.n_badly_explained or 0) / max(1, coded.n_regions)
    if not new_atoms and share > MANY:
        warnings.warn(
            f"{share:.0%} of the regions of {view_name!r} are badly explained by the field's codebook; add atoms for "
            "them (`new_atoms=8`), or build again with this view",
            ScoupWarning,
            stacklevel=4,
        )


def _record(
    add: Sequence[Camera], coded: Sequence[CodedView], remove: Sequence[str], levels: Sequence[str]
) -> dict[str, Any]:
    """Return the record of an update for the field's provenance."""
    atoms = {
        camera.name: dict(zip(levels, view.n_new, strict=True))
        for camera, view in zip(add, coded, strict=True)
        if any(view.n_new)
    }
    record: dict[str, Any] = {"added": [camera.name for camera in add], "removed": list(remove)}
    return {**record, "new_atoms": atoms} if atoms else record


def _cameras(cameras: Cameras | None, add: Sequence[Camera], remove: Sequence[str]) -> Cameras | None:
    if cameras is None:
        return None
    new = {camera.name: camera for camera in add}
    kept = [new.pop(camera.name, camera) for camera in cameras if camera.name not in remove]
    return Cameras([*kept, *(camera for name, camera in new.items() if name not in remove)])
