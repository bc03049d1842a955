"""Shards: the region sums of a share of the views, in a folder with everything a merge needs to know of these views.

Views are independent, so processes can make shards in any order and on any machines: a Slurm array, make, Ray, or a
batch in a cloud. ``merge`` reads them, learns the codes of all regions and votes (docs/many_machines.md).
"""

from __future__ import annotations

import hashlib
import json
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
from scoup.field.container import place_of, relative_place
from scoup.field.language_field import LanguageField
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.scene.sanity_checks import sanity_problems
from scoup.uplift import fit
from scoup.uplift.build import Sources, thing_table, vote_field
from scoup.uplift.build_settings import BuildSettings, build_settings
from scoup.uplift.rasterise import add_views, cameras_with_regions, check_sums
from scoup.uplift.region_codes import RegionEmbeddings, inputs_digest, learn_region_codes
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.storage.paths import ENDING, INPUTS

_REMEDY = "make the shard again"


@dataclass(frozen=True, eq=False)
class Shard:
    """The inputs of a shard that a merge needs beside its region sums."""

    sources: Sources
    places: tuple[int, ...]  # of these views among all views of the scene with regions
    n_views: int  # of the scene, with regions
    scene: str  # digest of names and cameras of all these views, in order
    embeddings: RegionEmbeddings  # of the shard's views

    def save(self, sums: RegionSums) -> None:
        """Keep it beside the region sums, unless they contain it already."""
        geometry = self.sources.geometry_path
        header = {
            "places": list(self.places),
            "n_views": self.n_views,
            "scene": self.scene,
            "cameras": [_camera_record(camera) for camera in self.sources.views],
            "embedding_model": self.sources.embedding_model,
            "words": relative_place(sums.path or Path("region sums"), self.sources.words),
            "geometry": None if geometry is None else str(geometry.absolute()),
            "ends": [[part.stop for part in rows.values()] for rows in self.embeddings.rows],
            "key": inputs_digest(sums.fingerprint, self.sources.views, self.embeddings, {}),
        }
        if sums.inputs is None or sums.inputs["header"] != header:
            sums.keep_inputs(header, dict(zip(_names(sums.levels), self.embeddings.of_levels, strict=True)))

    @classmethod
    def load(cls, sums: RegionSums) -> Shard:
        """Read the one kept beside region sums; a FileFormatError if it is missing, invalid, or lacks views."""
        path = sums.path or Path("region sums")
        if sums.inputs is None:
            raise FileFormatError(path, "is not a shard: it contains region sums only", _REMEDY)
        try:
            shard = cls._of_record(sums.levels, path, sums.inputs["header"], sums.inputs["tensors"])
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, InputError) as error:
            file = path if sums.path is None else path / f"{INPUTS}{ENDING}"
            raise FileFormatError(file, f"is not a valid shard ({error})", _REMEDY) from error
        lacking = [view.name for view in shard.sources.views if view.name not in sums]
        if lacking:
            raise FileFormatError(path, f"lacks the region sums of {listed(lacking, 3)}", _REMEDY)
        return shard

    @classmethod
    def _of_record(
        cls, levels: Sequence[str], path: Path, header: dict[str, Any], tensors: dict[str, Tensor]
    ) -> Shard:
        views = tuple(_camera(record) for record in header["cameras"])
        names = [view.name for view in views]
        places, n_views = tuple(int(place) for place in header["places"]), int(header["n_views"])
        if not len(set(places)) == len(places) == len(set(names)) == len(names):
            raise ValueError("views that are there twice")
        if not all(0 <= place < n_views for place in places):
            raise ValueError("views without a place")
        rows, of_levels = [], [tensors[name] for name in _names(levels)]
        for of_level, part in zip(header["ends"], of_levels, strict=True):
            bounds = [0, *(int(end) for end in of_level)]
            if part.dim() != 2 or bounds != sorted(bounds) or bounds[-1] != len(part):
                raise ValueError("embeddings of other regions")
            rows.append({name: slice(*ends) for name, ends in zip(names, pairwise(bounds), strict=True)})
        words = place_of(path, header["words"])
        sources = Sources.of(views, str(header["embedding_model"]), words, header["geometry"])
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
    words: str | Path | None = None,
    geometry_path: str | Path | None = None,
    backend: str | None = None,
    check_fit: bool = True,
    progress: Progress = no_progress,
) -> Shard:
    """Rasterise a share of the views, and keep beside their region sums what ``merge`` needs to know of them.

    Args:
        sums: of these Gaussians, in a folder; only views that they lack are rasterised.
        gaussians, cameras, regions: as for ``build``; pass the same for all shares of a scene.
        share: which of the views with regions (``Share.of``).
        embedding_model, words, geometry_path, backend, check_fit, progress: as for ``build``.

    Raises, Warns:
        As ``build``.
    """
    check_arguments(
        "add_shard", gaussians=(gaussians, Gaussians), cameras=(cameras, Cameras), regions=(regions, Regions)
    )
    for problem in sanity_problems(gaussians):
        warnings.warn(problem, ScoupWarning, stacklevel=2)
    check_sums(sums, gaussians, regions, sums.raster_preset)
    everything = cameras_with_regions(cameras, regions)
    views = share.of(everything)
    shard = Shard(
        Sources.of(views, embedding_model, words, geometry_path),
        tuple(share.of(range(len(everything)))),
        len(everything),
        _digest(everything),
        RegionEmbeddings.load(regions.select([view.name for view in views])),
    )
    if check_fit and views and not len(sums):
        fit.check_fit(gaussians, views, sums.raster_preset, backend, geometry_path)
    shard.save(sums)
    add_views(sums, gaussians, views, regions, backend, progress)
    return shard


def merge(
    shards: Sequence[RegionSums],
    settings: BuildSettings | str = "default",
    *,
    keep: RegionSums | None = None,
    geometry_path: str | Path | None = None,
    device: torch.device | str = "cpu",
    backend: str | None = None,
    progress: Progress = no_progress,
) -> LanguageField:
    """Merge shards into the language field of their views: of all shards, the same field as ``build`` makes.

    Args:
        shards: made by ``add_shard``, in any order; a view may be in several.
        settings: as for ``build``; the rasteriser preset is that of the shards.
        keep: empty region sums (``RegionSums.empty_like``), to which the views and codes are added.
        geometry_path: file of the Gaussians; by default that of the first shard.
        device, backend: of coding and vote.
        progress: as for ``build``.

    Warns:
        ScoupWarning: views of the scene are in no shard.
    """
    if not shards:
        raise InputError("there are no shards to merge")
    settings = replace(build_settings(settings), raster_preset=shards[0].raster_preset)
    parts = [Shard.load(sums) for sums in shards]
    places = _find_views(shards, parts)
    _warn_of_missing(parts, len(places))
    sums = RegionSums.concatenate({name: shards[number] for name, (number, _) in places.items()})
    embeddings = RegionEmbeddings.concatenate(
        [(parts[number].embeddings, name) for name, (number, _) in places.items()]
    )
    views = [parts[number].sources.views[place] for number, place in places.values()]
    first = parts[0].sources
    geometry = first.geometry_path if geometry_path is None else geometry_path

    device = torch.device(device)
    codes = learn_region_codes(sums if keep is None else keep, embeddings, settings, device, progress)
    digest = inputs_digest(sums.fingerprint, views, embeddings, asdict(settings))
    del embeddings, parts  # the vote needs the codes only
    if keep is not None:
        for name in places:
            keep.append_record(name, sums.views[name])
    things = thing_table(sums, codes, progress)
    sources = Sources.of(views, first.embedding_model, first.words, geometry, digest)
    return vote_field(sums, codes, things, sources, settings, device, backend, progress)


def _find_views(shards: Sequence[RegionSums], parts: Sequence[Shard]) -> dict[str, tuple[int, int]]:
    """Return, for each view in the order of the scene, its shard and its place there; an InputError if shards do not
    belong together."""
    first = shards[0]
    found: dict[int, tuple[str, int, int]] = {}
    for number, (sums, part) in enumerate(zip(shards, parts, strict=True)):
        if not first.is_compatible(sums) or (part.n_views, part.scene) != (parts[0].n_views, parts[0].scene):
            raise InputError(
                f"{sums.path} and {first.path}: are shards of other scenes or cameras, or made with other "
                "options; merge the shards of one scene, all made with the same options"
            )
        for place, (view, where) in enumerate(zip(part.sources.views, part.places, strict=True)):
            name, other, _ = found.setdefault(where, (view.name, number, place))
            if name != view.name or not _same_view(sums, shards[other], part, parts[other], name):
                raise InputError(
                    f"{sums.path} and {shards[other].path}: contain other regions of the view {view.name}; "
                    "make them again, from one scene"
                )
    return {name: (number, place) for _, (name, number, place) in sorted(found.items())}


def _same_view(sums: RegionSums, other: RegionSums, part: Shard, others: Shard, name: str) -> bool:
    mine, its = sums.views[name], other.views[name]
    return mine.digests == its.digests and all(
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
    """Return a SHA-256 of names and cameras, to recognise shards of one scene."""
    known = [[camera.name, camera.fingerprint()] for camera in cameras]
    return hashlib.sha256(json.dumps(known).encode()).hexdigest()


def _names(levels: Sequence[str]) -> list[str]:
    """Return the names of the arrays of embeddings."""
    return [f"embeddings.{number}" for number in range(len(levels))]


def _camera_record(camera: Camera) -> dict[str, Any]:
    """Return a camera as JSON values, which keep its numbers exactly; without its photograph."""
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
