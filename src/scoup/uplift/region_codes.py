"""Embeddings and codes of the regions of all views; the vote multiplies the region sums with the codes."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.base.progress import Progress, no_progress
from scoup.base.version import VERSION
from scoup.coding import fit_codes
from scoup.scene.cameras import Camera
from scoup.scene.codes import SparseCodes
from scoup.scene.regions import Regions
from scoup.uplift.build_settings import BuildSettings
from scoup.uplift.region_sums import RegionSums, Rows


@dataclass(frozen=True, eq=False)
class RegionEmbeddings:
    """The embeddings of the regions of all views."""

    levels: tuple[str, ...]
    of_levels: Sequence[Tensor]  # S x [R, D] float32, one row per region of any view
    rows: Rows

    @classmethod
    def load(cls, regions: Regions) -> RegionEmbeddings:
        """Read the embeddings of all views of ``regions``."""
        if not len(regions):
            none: Rows = [{} for _ in regions.levels]
            return cls(regions.levels, [torch.zeros(0, 0) for _ in regions.levels], none)
        of_levels, rows = zip(*(regions.embeddings(level) for level in regions.levels), strict=True)
        return cls(regions.levels, of_levels, rows)

    @classmethod
    def concatenate(cls, parts: Sequence[tuple[RegionEmbeddings, str]]) -> RegionEmbeddings:
        """Return the embeddings of views, each given as embeddings that contain it and its name."""
        levels = parts[0][0].levels
        blocks = [part.of_view(name) for part, name in parts]
        rows: list[dict[str, slice]] = []
        for of_level in zip(*blocks, strict=True):
            ends = list(accumulate(map(len, of_level), initial=0))
            rows.append({name: slice(*ends[i : i + 2]) for i, (_, name) in enumerate(parts)})
        sizes = {block.shape[1] for of_view in blocks for block in of_view}
        if len(sizes) > 1:
            raise InputError(f"the views have embeddings of different sizes {sorted(sizes)}: they mix models")
        return cls(levels, [torch.cat(of_level) for of_level in zip(*blocks, strict=True)], rows)

    def of_view(self, view_name: str) -> list[Tensor]:
        """Return S x [R, D], the embeddings of one view."""
        return [part[rows[view_name]] for part, rows in zip(self.of_levels, self.rows, strict=True)]

    def check(self) -> None:
        """Raise an InputError if they cannot be coded: a level is empty or all zero, or levels differ in size."""
        sizes = {level: part.shape[1] for level, part in zip(self.levels, self.of_levels, strict=True)}
        if len(set(sizes.values())) > 1:
            raise InputError(f"the levels have embeddings of different sizes {sizes}: they mix models")
        for level, part in zip(self.levels, self.of_levels, strict=True):
            if not len(part):
                raise InputError(f"level {level!r} has no regions in any view; every level needs some")
            if not part.any():
                raise InputError(
                    f"level {level!r} has only zero embeddings, as the embedder colors makes of black photographs; "
                    "check the photographs, or extract the regions with a CLIP model"
                )


@dataclass(frozen=True, eq=False)
class RegionCodes:
    """One codebook and one set of codes per level."""

    codebook: Tensor  # [S, L, D] float32
    codes: Sequence[SparseCodes]  # per level, of the regions of all views
    rows: Rows
    reports: Sequence[dict[str, Any]]  # per level, report of the coding as JSON values
    embeddings: Sequence[Tensor] = ()  # per level [R, D] float16, to find things again; empty without things

    @property
    def n_atoms(self) -> int:
        return self.codebook.shape[1]

    def save(self, sums: RegionSums, key: str) -> None:
        """Keep them beside region sums; ``key`` is a digest of everything they depend on."""
        tensors = {"codebook": self.codebook}
        for s, level in enumerate(self.codes):
            tensors |= {f"indices.{s}": level.indices, f"weights.{s}": level.weights}
        tensors |= {f"embeddings.{s}": rows for s, rows in enumerate(self.embeddings)}
        rows = [{name: [part.start, part.stop] for name, part in level.items()} for level in self.rows]
        sums.keep_codes({"key": key, "rows": rows, "reports": list(self.reports)}, tensors)

    @classmethod
    def load(cls, sums: RegionSums, key: str | None = None) -> RegionCodes | None:
        """Return the codes kept beside region sums; None if there are none, or of another ``key``."""
        if sums.codes is None or (key is not None and sums.codes["header"].get("key") != key):
            return None
        header, tensors = sums.codes["header"], sums.codes["tensors"]
        try:
            codebook = tensors["codebook"]
            codes = [
                SparseCodes(tensors[f"indices.{s}"], tensors[f"weights.{s}"], codebook.shape[1])
                for s in range(len(codebook))
            ]
            rows = [
                {str(name): slice(int(start), int(stop)) for name, (start, stop) in level.items()}
                for level in header["rows"]
            ]
            if len(rows) != len(codes) or len(header["reports"]) != len(codes):
                raise ValueError("levels are missing")
            places = range(len(codes)) if "embeddings.0" in tensors else ()
            embeddings = [tensors[f"embeddings.{s}"] for s in places]
            if any(len(part) != len(of_level) for part, of_level in zip(embeddings, codes, strict=False)):
                raise ValueError("embeddings of other regions")
            return cls(codebook, codes, rows, list(header["reports"]), embeddings)
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, InputError) as error:
            raise InputError(f"{sums.path}: the codes in it are invalid ({error}); build again") from error

    def without_view(self, view_name: str) -> RegionCodes:
        """Return them without one view, whose codes stay unused."""
        if view_name not in self.rows[0]:
            known = ", ".join(list(self.rows[0])[:5])
            raise InputError(f"the view {view_name!r} is not in the field; its views are {known}, ...")
        rows = [{name: part for name, part in level.items() if name != view_name} for level in self.rows]
        return replace(self, rows=rows)

    def with_view(
        self, view_name: str, codes: Sequence[SparseCodes], codebook: Tensor, embeddings: Sequence[Tensor]
    ) -> RegionCodes:
        """Add or replace a view, given codes and embeddings [R, D] of its regions per level.

        ``codebook`` [S, L', D] begins with the atoms of before.
        """
        longer, rows = [], []
        for old, new, places in zip(self.codes, codes, self.rows, strict=True):
            longer.append(concatenate_codes(old, new))
            rows.append({**places, view_name: slice(len(old), len(old) + len(new))})
        parts = zip(self.embeddings, embeddings, strict=False)
        known = [torch.cat([of_level, own.cpu().half()]) for of_level, own in parts]
        return RegionCodes(codebook, longer, rows, self.reports, known)

    def compact(self) -> RegionCodes:
        """Drop unused codes if they are more than half of all."""
        used = sum(part.stop - part.start for level in self.rows for part in level.values())
        if 2 * used >= sum(map(len, self.codes)):
            return self
        codes, rows, chosen = [], [], []
        for level, places in zip(self.codes, self.rows, strict=True):
            chosen.append(torch.cat([torch.arange(part.start, part.stop) for part in places.values()]))
            codes.append(level.rows(chosen[-1]))
            sizes = [part.stop - part.start for part in places.values()]
            ends = zip(places, sizes, accumulate(sizes), strict=True)
            rows.append({name: slice(end - size, end) for name, size, end in ends})
        embeddings = [part[own] for part, own in zip(self.embeddings, chosen, strict=False)]
        return RegionCodes(self.codebook, codes, rows, self.reports, embeddings)


def learn_region_codes(
    sums: RegionSums,
    embeddings: RegionEmbeddings,
    settings: BuildSettings,
    device: torch.device,
    progress: Progress = no_progress,
) -> RegionCodes:
    """Learn the codes of every level and keep them beside the sums.

    Codes of the same embeddings and settings that are there already are used.
    """
    embeddings.check()
    key = inputs_digest("", [], embeddings, settings.of_codes)
    kept = RegionCodes.load(sums, key)
    if kept is not None:
        return kept
    learned: list[tuple[Tensor, SparseCodes, dict[str, Any]]] = []
    for level, rows in zip(embeddings.levels, embeddings.of_levels, strict=True):
        stage = f"coding {level}"
        book = fit_codes(
            rows.to(device),
            **settings.of_fit,
            progress=lambda _, done, total, stage=stage: progress(stage, done, total),
        )
        # With seconds, two equal builds would write different bytes.
        report = {name: value for name, value in asdict(book.report).items() if name != "seconds"}
        learned.append((book.atoms.cpu(), book.codes.to("cpu"), report))
    atoms, codes, reports = zip(*learned, strict=True)
    known = [rows.cpu().half() for rows in embeddings.of_levels] if settings.things else []
    coded = RegionCodes(torch.stack(atoms), codes, embeddings.rows, reports, known)
    if sums.writable:
        coded.save(sums, key)
    return coded


def concatenate_codes(first: SparseCodes, second: SparseCodes) -> SparseCodes:
    """Return the rows of both over the atoms of the second; shorter codes are padded with zeros."""
    k = max(first.k, second.k)
    parts = [
        # int64, because torch.cat supports uint16 only in part
        [torch.nn.functional.pad(part, (0, k - codes.k)) for part in (codes.indices.long(), codes.weights)]
        for codes in (first, second)
    ]
    indices, weights = map(torch.cat, zip(*parts, strict=True))
    return SparseCodes(indices.to(second.indices.dtype), weights, second.n_atoms)


def inputs_digest(
    fingerprint: str, cameras: Sequence[Camera], embeddings: RegionEmbeddings, settings: Mapping[str, Any]
) -> str:
    """Return a SHA-256 of everything a result depends on but label maps, which have a digest per view.

    ``fingerprint`` is that of the Gaussians, ``settings`` are JSON values.
    """
    digest = hashlib.sha256(json.dumps([VERSION, fingerprint, settings], sort_keys=True).encode())
    for camera in cameras:
        digest.update(json.dumps([camera.name, camera.fingerprint()]).encode())
    for level, of_level, rows in zip(embeddings.levels, embeddings.of_levels, embeddings.rows, strict=True):
        ends = {name: part.stop for name, part in rows.items()}
        digest.update(json.dumps([level, list(of_level.shape), ends]).encode())
        digest.update(of_level.contiguous().numpy().data)
    return digest.hexdigest()
