"""Shards: the region sums of a share of the views, each in a folder with all that a merge needs to know of these views.

Views are independent and sums add up, so any processes may make shards, in any order and on any machines: a Slurm
array, make, Ray, or a batch of a cloud. A merge reads them, learns the codes of all regions and votes
(docs/many_machines.md).
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base.arguments import check_arguments
from scoup.base.counts import counted, listed, verb
from scoup.base.errors import FileFormatError, InputError, ScoupWarning
from scoup.base.progress import Progress, no_progress
from scoup.base.shares import Share
from scoup.field.language_field import LanguageField
from scoup.models.word_table import is_table
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.oddities import oddities
from scoup.scene.regions import Regions
from scoup.uplift import fit
from scoup.uplift.build import Sources, things_of, voted
from scoup.uplift.build_settings import BuildSettings, build_settings
from scoup.uplift.rasterise import add_views, cameras_with_regions, check_sums
from scoup.uplift.region_codes import RegionEmbeddings, inputs_digest, learn_region_codes
from scoup.uplift.region_sums import ENDING, INPUTS, RegionSums

_REMEDY = "make it again with scoup build --shard"


@dataclass(frozen=True, eq=False)
class Shard:
    """What is known of the views of a shard beside their region sums.

    Attributes:
        sources: its cameras, and what a field says of its origin.
        places: of these views among all views of the scene with regions.
        n_views: how many these are.
        scene: digest of their names and cameras, in their order.
        embeddings: of the regions of the shard's views.
    """

    sources: Sources
    places: tuple[int, ...]
    n_views: int
    scene: str
    embeddings: RegionEmbeddings

    def keep(self, sums: RegionSums) -> None:
        """Keep it beside the region sums, unless it is there already."""
        header = {
            "places": list(self.places),
            "n_views": self.n_views,
            "scene": self.scene,
            "cameras": [_camera_record(camera) for camera in self.sources.views],
            "embedding_model": self.sources.embedding_model,
            "geometry": None
            if self.sources.geometry_path is None
            else str(self.sources.geometry_path.absolute()),
            "ends": [[part.stop for part in rows.values()] for rows in self.embeddings.rows],
            "key": inputs_digest(sums.fingerprint, self.sources.views, self.embeddings, {}),
        }
        if sums.inputs is None or sums.inputs["header"] != header:
            sums.keep_inputs(header, dict(zip(_names(sums.levels), self.embeddings.of_levels, strict=True)))

    @classmethod
    def kept(cls, sums: RegionSums) -> Shard:
        """The one kept beside region sums.

        Raises:
            FileFormatError: there is none, it makes no sense, or views are missing.
        """
        path = sums.path or Path("region sums")
        if sums.inputs is None:
            raise FileFormatError(path, "is no shard: it holds region sums alone", _REMEDY)
        try:
            shard = cls._of_record(sums.levels, sums.inputs["header"], sums.inputs["tensors"])
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, InputError) as error:
            file = path if sums.path is None else path / f"{INPUTS}{ENDING}"
            raise FileFormatError(file, f"makes no sense as a shard ({error})", _REMEDY) from error
        lacking = [view.name for view in shard.sources.views if view.name not in sums]
        if lacking:
            raise FileFormatError(path, f"lacks the region sums of {listed(lacking, 3)}", _REMEDY)
        return shard

    @classmethod
    def _of_record(cls, levels: Sequence[str], header: dict[str, Any], tensors: dict[str, Tensor]) -> Shard:
        views = tuple(_camera(record) for record in header["cameras"])
        names = [view.name for view in views]
        places, n_views = tuple(int(place) for place in header["places"]), int(header["n_views"])
        if not len(set(places)) == len(places) == len(set(names)) == len(names):
            raise ValueError("views that are not one each")
        if not all(0 <= place < n_views for place in places):
            raise ValueError("views without a place")
        rows, of_levels = [], [tensors[name] for name in _names(levels)]
        for of_level, part in zip(header["ends"], of_levels, strict=True):
            bounds = [0, *(int(end) for end in of_level)]
            if part.dim() != 2 or bounds != sorted(bounds) or bounds[-1] != len(part):
                raise ValueError("embeddings of other regions")
            rows.append({name: slice(*ends) for name, ends in zip(names, pairwise(bounds), strict=True)})
        geometry = None if header["geometry"] is None else Path(header["geometry"])
        sources = Sources(views, str(header["embedding_model"]), geometry)
        scene = str(header["scene"])
        return cls(sources, places, n_views, scene, RegionEmbeddings(tuple(levels), of_levels, rows))


def add_shard(  # noqa: PLR0913  the public face: each keyword is one choice of the user
    sums: RegionSums,
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    share: Share,
    *,
    embedding_model: str = "",
    geometry_path: str | Path | None = None,
    backend: str | None = None,
    check_fit: bool = True,
    progress: Progress = no_progress,
) -> Shard:
    """Rasterise a share of the views, and keep beside their region sums what ``merge`` needs to know of them.

    Args:
        sums: of these Gaussians, in a folder; views that are in them already are not rasterised again.
        gaussians, cameras, regions: as for ``build``; all shares of a scene must be given the same.
        share: which of the views with regions (``Share.of``).
        embedding_model, geometry_path, backend, check_fit, progress: as for ``build``.

    Raises:
        InputError: no camera has regions, or the inputs do not fit.

    Warns:
        ScoupWarning: Gaussians are absurd, or splat and cameras may not fit.
    """
    check_arguments(
        "add_shard", gaussians=(gaussians, Gaussians), cameras=(cameras, Cameras), regions=(regions, Regions)
    )
    for oddity in oddities(gaussians):
        warnings.warn(oddity, ScoupWarning, stacklevel=2)
    check_sums(sums, gaussians, regions, sums.raster_preset)
    everything = cameras_with_regions(cameras, regions)
    views = share.of(everything)
    path = None if geometry_path is None else Path(geometry_path)
    shard = Shard(
        Sources(tuple(views), embedding_model, path),
        tuple(share.of(range(len(everything)))),
        len(everything),
        _digest(everything),
        RegionEmbeddings.unchecked(regions.select([view.name for view in views])),
    )
    if check_fit and views and not len(sums):
        fit.check_fit(gaussians, views, sums.raster_preset, backend, geometry_path)
    shard.keep(sums)
    add_views(sums, gaussians, views, regions, backend, progress)
    return shard


def merge(
    shards: Sequence[RegionSums],
    settings: BuildSettings | str = "default",
    *,
    keep: RegionSums | None = None,
    geometry_path: str | Path | None = None,
    field_path: Path | None = None,
    device: torch.device | str = "cpu",
    backend: str | None = None,
    progress: Progress = no_progress,
) -> LanguageField:
    """The language field of the views of some shards: of all of them, the one that ``build`` makes of the scene.

    Args:
        shards: what ``add_shard`` has made, in any order; a view may be in several.
        settings: as for ``build``; their rasteriser preset counts for nothing, since that of the shards is known.
        keep: empty region sums of the same Gaussians (``like``), to which the views and codes are added.
        geometry_path: the file of the Gaussians; by default that of the first shard.
        field_path: where the field will be saved, if elsewhere than its shards: a word table is named relative to it.
        device, backend: of coding and vote.
        progress: as for ``build``.

    Raises:
        InputError: there is none, they are of different scenes, two hold different sums of one view, or their views
            have no regions.

    Warns:
        ScoupWarning: views of the scene are in none of them.
    """
    if not shards:
        raise InputError("there are no shards to merge")
    settings = replace(build_settings(settings), raster_preset=shards[0].raster_preset)
    parts = [Shard.kept(sums) for sums in shards]
    holders = _holders(shards, parts)
    _warn_of_missing(parts, len(holders))
    sums = RegionSums.joined(shards, {name: shards[number] for name, (number, _) in holders.items()})
    embeddings = RegionEmbeddings.joined(
        [(parts[number].embeddings, name) for name, (number, _) in holders.items()]
    )
    views = [parts[number].sources.views[place] for number, place in holders.values()]
    model = _moved(parts[0].sources.embedding_model, shards[0].path, field_path)
    path = parts[0].sources.geometry_path if geometry_path is None else Path(geometry_path)

    device = torch.device(device)
    codes = learn_region_codes(sums if keep is None else keep, embeddings, settings, device, progress)
    digest = inputs_digest(sums.fingerprint, views, embeddings, asdict(settings))
    del embeddings, parts  # the vote needs the codes only
    if keep is not None:
        for name in holders:
            keep.append_record(name, sums.views[name])
    things = things_of(sums, codes, progress)
    sources = Sources(tuple(views), model, path, digest)
    return voted(sums, codes, things, sources, settings, device, backend, progress)


def _moved(model: str, shard: Path | None, field: Path | None) -> str:
    """The embedding model; a word table, which is named relative to the shard, relative to the field."""
    if shard is None or field is None or not is_table(model):
        return model
    return Path(os.path.relpath(shard.absolute().parent / model, field.absolute().parent)).as_posix()


def _holders(shards: Sequence[RegionSums], parts: Sequence[Shard]) -> dict[str, tuple[int, int]]:
    """For each view, in the order of the scene: which shard holds it, and at which place there.

    Raises:
        InputError: the shards do not belong together.
    """
    first = shards[0]
    found: dict[int, tuple[str, int, int]] = {}
    for number, (sums, part) in enumerate(zip(shards, parts, strict=True)):
        if not first.is_like(sums) or (part.n_views, part.scene) != (parts[0].n_views, parts[0].scene):
            raise InputError(
                f"{sums.path} and {first.path}: are shards of other scenes or cameras, or made with other "
                "options; give the shards of one scene, all made by the same command but for --shard"
            )
        for place, (view, where) in enumerate(zip(part.sources.views, part.places, strict=True)):
            name, other, _ = found.setdefault(where, (view.name, number, place))
            if name != view.name or not _same_view(sums, shards[other], part, parts[other], name):
                raise InputError(
                    f"{sums.path} and {shards[other].path}: hold other regions of the view {view.name}; make them "
                    "again, from one scene"
                )
    return {name: (number, place) for _, (name, number, place) in sorted(found.items())}


def _same_view(sums: RegionSums, other: RegionSums, part: Shard, others: Shard, name: str) -> bool:
    mine, its = sums.views[name], other.views[name]
    same = (mine.camera_digest, mine.labels_digest) == (its.camera_digest, its.labels_digest)
    return same and all(
        torch.equal(a, b)
        for a, b in zip(part.embeddings.of_view(name), others.embeddings.of_view(name), strict=True)
    )


def _warn_of_missing(parts: Sequence[Shard], n_found: int) -> None:
    missing = parts[0].n_views - n_found
    if missing:
        warnings.warn(
            f"{counted(missing, 'view')} of {parts[0].n_views:,} {verb(missing, 'is', 'are')} in none of the shards; "
            "the field is made of the others",
            ScoupWarning,
            stacklevel=3,
        )


def _digest(cameras: Sequence[Camera]) -> str:
    """SHA-256 of names and cameras, by which shards of one scene know each other."""
    known = [[camera.name, camera.fingerprint()] for camera in cameras]
    return hashlib.sha256(json.dumps(known).encode()).hexdigest()


def _names(levels: Sequence[str]) -> list[str]:
    """Of the arrays of embeddings."""
    return [f"embeddings.{number}" for number in range(len(levels))]


def _camera_record(camera: Camera) -> dict[str, Any]:
    """A camera as JSON values, which hold its numbers exactly; without its photograph."""
    return {
        "name": camera.name,
        "viewmat": camera.viewmat.tolist(),
        "K": camera.K.tolist(),
        "size": [camera.width, camera.height],
        "distortion": list(camera.distortion),
    }


def _camera(record: dict[str, Any]) -> Camera:
    viewmat, intrinsics = (np.array(record[name], np.float64) for name in ("viewmat", "K"))
    width, height = (int(side) for side in record["size"])
    return Camera(
        str(record["name"]), torch.from_numpy(viewmat), torch.from_numpy(intrinsics), width, height,
        distortion=tuple(float(value) for value in record["distortion"]),
    )  # fmt: skip
