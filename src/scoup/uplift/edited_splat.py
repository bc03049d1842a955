"""``follow``: a field follows an edit of its splat: Gaussians deleted, appended, reordered, or rounded by a format."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.base.brief import brief
from scoup.base.counts import listed
from scoup.base.errors import InputError, ScoupWarning
from scoup.base.progress import Progress, no_progress
from scoup.field.language_field import LanguageField
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import signed
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.scene.things import NO_THING, ThingTable
from scoup.uplift.build import thing_table
from scoup.uplift.matching import Matching, Tolerance, match
from scoup.uplift.rasterise import add_views
from scoup.uplift.region_codes import RegionCodes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.storage.entries import MOST_COMBINATIONS, ViewRecord, pack
from scoup.uplift.update import append_update, field_codes, vote_again

MANY = 0.1  # share of the Gaussians; an edit seldom replaces as many


@dataclass(frozen=True, eq=False)
class Followed:
    """A field that has followed its splat."""

    field: LanguageField
    """Field of the edited splat."""
    matching: Matching
    """Rows of the Gaussians before and after."""
    sums: RegionSums | None = None
    """Region sums of the edited splat, if region sums were passed."""
    rasterised: tuple[str, ...] = ()
    """Names of the views in which the edit is visible."""

    __repr__ = brief


@dataclass(frozen=True, eq=False)
class KeptSums:
    """Region sums of a field, and its views, some of which may be rasterised again."""

    sums: RegionSums
    """Region sums of the field, with the codes of its regions; not changed."""
    cameras: Cameras
    """Cameras of the views in the sums."""
    regions: Regions
    """Regions of these views, unchanged since the build."""
    path: Path | None = None
    """New folder for the sums of the edited splat; None keeps them in memory."""


def follow(
    field: LanguageField,
    gaussians: Gaussians,
    kept: KeptSums | None = None,
    tolerance: Tolerance | None = None,
    *,
    geometry_path: str | Path | None = None,
    backend: str | None = None,
    progress: Progress = no_progress,
) -> Followed:
    """Bring a field to its splat after an edit, without building it again: Gaussians deleted, appended or reordered.

    Gaussians are matched by their numbers (``match``). Without region sums, matched Gaussians keep their codes, bit by
    bit, and appended ones have none. With region sums, only views in which the edit is visible are rasterised again,
    and all views vote: the codes are the same as with region sums made from the edited splat.

    Args:
        field: not changed. Its geometry is read.
        gaussians: the edited splat, in the frame of the original.
        kept: region sums of the field.
        tolerance: for formats that round; None matches equal bytes only. Rounded Gaussians keep their codes, but the
            views that show them are rasterised again.
        geometry_path: file of the edited splat, recorded in the new field.
        backend: of rasteriser and vote.
        progress: called for the stages "region sums" and "vote".

    Raises:
        InputError: the edited splat shares no Gaussian with the field's, the sums are of another field, or a view that
            shows the edit has another camera or other regions than at the build.

    Warns:
        ScoupWarning: without a tolerance, many Gaussians were both deleted and appended, as by a format that rounds.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> edited = field.gaussians.select(torch.arange(100))  # as an editor of splats leaves it
        >>> followed = scoup.follow(field, edited)
        >>> len(followed.field.gaussians)
        100
    """
    check_arguments("follow", field=(field, LanguageField), gaussians=(gaussians, Gaussians))
    gaussians = gaussians.to(field.codebook.device)
    before = field.gaussians
    matching = match(before, gaussians, tolerance)
    _check_matching(matching, str(geometry_path or "the edited splat"), tolerance is not None)
    record: dict[str, Any] = {"from": field.fingerprint, **matching.counts()}
    path = None if geometry_path is None else Path(geometry_path)
    if kept is None:
        indices, weights = (
            _carry_over(field.code_indices, matching),
            _carry_over(field.code_weights, matching),
        )
        things = field.thing_table
        if things is not None:
            things = replace(things, owners=_carry_over(things.owners, matching, NO_THING))
        return Followed(_make_field(field, gaussians, (indices, weights), things, record, path), matching)
    coded = field_codes(field, kept.sums)
    sums, changed = _follow_sums(kept, coded, before, gaussians, matching, backend, progress)
    coded.compact().save(sums, "")
    record["rasterised"] = list(changed)
    if matching.is_identity:
        codes = field.code_indices, field.code_weights
        made = _make_field(field, gaussians, codes, field.thing_table, record, path)
        return Followed(made, matching, sums, changed)
    found = vote_again(field, sums, coded, backend, progress)
    if found.sharpness is not None:
        record["sharpness"] = found.sharpness.tolist()
    things = thing_table(sums, coded, progress=progress)
    made = _make_field(field, gaussians, (found.indices, found.weights), things, record, path)
    return Followed(made, matching, sums, changed)


def _check_matching(matching: Matching, source: str, tolerant: bool) -> None:
    if not matching.n_matched:
        remedy = "" if tolerant else " (if its format rounds, with `tolerance`)"
        raise InputError(
            f"{source}: shares no Gaussian with the field; use the field's own splat after an edit{remedy}, or build "
            "the field again"
        )
    if not tolerant and min(matching.n_appended, matching.n_deleted) > MANY * matching.n_before:
        warnings.warn(
            f"{source}: {matching.n_deleted:,} Gaussians of the field are not in it, and {matching.n_appended:,} of "
            "its own are not in the field; if its format rounds numbers, pass `tolerance`",
            ScoupWarning,
            stacklevel=3,
        )


def _carry_over(rows: Tensor, matching: Matching, others: int = 0) -> Tensor:
    """Return rows [M, ...] such as codes or owners of matched Gaussians; ``others`` for unmatched ones."""
    before = matching.before.to(rows.device)
    carried = signed(rows)[before.clamp(min=0)]
    carried[before < 0] = others
    return carried.view(rows.dtype)


def _make_field(
    field: LanguageField,
    gaussians: Gaussians,
    codes: tuple[Tensor, Tensor],
    things: ThingTable | None,
    record: dict[str, Any],
    path: Path | None,
) -> LanguageField:
    """Return the field with other Gaussians and codes, and ``record`` in its provenance."""
    sharpness = record.pop("sharpness", None)
    provenance = dict(field.info.provenance)
    provenance |= append_update(provenance, {"edited": record})
    if sharpness is not None:
        provenance["sharpness"] = sharpness
    info = replace(
        field.info, fingerprint=gaussians.fingerprint(), n_gaussians=len(gaussians), provenance=provenance
    )
    known = {"geometry_path": path, "cameras": field.cameras, "thing_table": things}
    made = LanguageField(*codes, field.codebook, info, **known)
    made = made.to(field.codebook.device)
    made.keep_encoder_of(field)
    made.attach(gaussians, known=True)
    return made


def _follow_sums(
    kept: KeptSums,
    coded: RegionCodes,
    before: Gaussians,
    after: Gaussians,
    matching: Matching,
    backend: str | None,
    progress: Progress,
) -> tuple[RegionSums, tuple[str, ...]]:
    """Make region sums of the edited splat; also return the names of the views that were rasterised."""
    old = kept.sums
    how = {"path": kept.path, "weights": old.weights, "least_weight": old.least_weight}
    sums = RegionSums.empty(after, old.levels, old.raster_preset, **how)
    edit = _Edit(before, after, matching, old, sums, backend)
    changed: list[Camera] = []
    for name in coded.rows[0]:
        camera = _camera_of(name, kept)
        places = edit.places(old.views[name])
        if places is None or edit.is_seen(camera):
            changed.append(camera)
        else:
            sums.append_record(name, _move_entries(old.views[name], places, sums))
    _check_unchanged(changed, kept)
    add_views(sums, after, changed, kept.regions, backend, progress)
    for camera in changed:
        if sums.views[camera.name].labels_digest != old.views[camera.name].labels_digest:
            raise _changed_since(camera.name, "its region maps have")
    return sums, tuple(camera.name for camera in changed)


def _camera_of(name: str, kept: KeptSums) -> Camera:
    """Return the camera of a view; an InputError if its sums were made with another."""
    if name not in kept.cameras.names:
        raise InputError(
            f"the view {name!r} of the field has no camera among {listed(kept.cameras.names)}; use the scene that the "
            "field was built from"
        )
    camera = kept.cameras[name]
    digest = kept.sums.views[name].camera_digest
    if digest and digest != camera.fingerprint():
        raise _changed_since(name, "its camera has")
    return camera


def _check_unchanged(changed: Sequence[Camera], kept: KeptSums) -> None:
    lacking = [camera.name for camera in changed if camera.name not in kept.regions]
    if lacking:
        raise InputError(
            f"the edit has changed views that have no region maps any more ({listed(lacking)}); use the features that "
            "the field was built from, or remove these views first"
        )


def _changed_since(name: str, what: str) -> InputError:
    return InputError(
        f"the view {name!r}: {what} changed since the field was built; bring the field up to date with the original "
        f"splat first, by adding the view {name!r} again"
    )


class _Edit:
    """The changed Gaussians of an edit, and the views in which they are visible.

    Changed are the deleted, appended and rounded Gaussians, and those whose order among the others has changed.
    """

    def __init__(
        self,
        before: Gaussians,
        after: Gaussians,
        matching: Matching,
        old: RegionSums,
        new: RegionSums,
        backend: str | None,
    ) -> None:
        unmoved = matching.unmoved()
        gone = torch.ones(len(before), dtype=torch.bool)
        gone[matching.before[unmoved]] = False
        self._preset = old.raster_preset
        self._nothing_stays = not bool(unmoved.any())
        parts = before.select(gone), after.select(~unmoved)
        self._changed = [raster.prepare_gaussians(part, backend) for part in parts if len(part)]
        place = torch.full((len(before),), -1)
        place[matching.before[unmoved]] = torch.argsort(new.order)[unmoved]
        self._place = place[
            old.order
        ].numpy()  # [N] from places in the old sums to places in the new; -1 if changed

    def places(self, view: ViewRecord) -> NDArray[np.int64] | None:
        """Return [E] new places of the entries of all parts of a view; None if a changed Gaussian has one."""
        places = np.concatenate([self._place[part.gaussians()] for part in view.parts])
        return None if (places < 0).any() else places

    def is_seen(self, camera: Camera) -> bool:
        """Return whether a changed Gaussian may contribute to a pixel.

        The changed ones are rendered alone: what contributes nothing then contributes nothing and hides nothing.
        """
        if self._nothing_stays:
            return True
        for part in self._changed:
            projection = raster.project(part, camera, self._preset)
            ones = torch.ones(len(part.gaussians), 1, device=part.gaussians.device)
            if bool((raster.render_channels(projection, ones)[1] > 0).any()):
                return True
        return False


def _move_entries(view: ViewRecord, places: NDArray[np.int64], sums: RegionSums) -> ViewRecord:
    """Return a view of the old sums with entries at new places."""
    combinations = np.concatenate(
        [part.combinations.astype(np.int64) + i * MOST_COMBINATIONS for i, part in enumerate(view.parts)]
    )
    weights = np.concatenate([part.weights for part in view.parts])
    table = np.concatenate([part.table for part in view.parts])
    order = np.argsort(places, kind="stable")  # combinations keep rising among the entries of a Gaussian
    parts = pack(places[order], combinations[order], weights[order], table, np.dtype(sums.weights))
    return replace(view, parts=tuple(parts))
