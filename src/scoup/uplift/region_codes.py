"""Embeddings and codes of the regions of all views: what the vote multiplies the region sums with."""

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
    """The embeddings of the regions of all views.

    Attributes:
        levels: level names.
        of_levels: S x [R, D] float32, one row a region of any view.
        rows: per level, the rows of each view in them.
    """

    levels: tuple[str, ...]
    of_levels: Sequence[Tensor]
    rows: Rows

    @classmethod
    def of(cls, regions: Regions) -> RegionEmbeddings:
        """Those of all views of ``regions``.

        Raises:
            InputError: they cannot be coded: a level has none, or none but zeros, or the levels differ in size.
        """
        return cls.unchecked(regions).checked()

    @classmethod
    def unchecked(cls, regions: Regions) -> RegionEmbeddings:
        """The same of any views, also of too few to be coded."""
        if not len(regions):
            none: Rows = [{} for _ in regions.levels]
            return cls(regions.levels, [torch.zeros(0, 0) for _ in regions.levels], none)
        of_levels, rows = zip(*(regions.embeddings(level) for level in regions.levels), strict=True)
        return cls(regions.levels, of_levels, rows)

    @classmethod
    def joined(cls, parts: Sequence[tuple[RegionEmbeddings, str]]) -> RegionEmbeddings:
        """Those of some views, in their order.

        Args:
            parts: embeddings that hold a view, and its name.

        Raises:
            InputError: they cannot be coded (``of``).
        """
        levels = parts[0][0].levels
        blocks = [part.of_view(name) for part, name in parts]
        rows: list[dict[str, slice]] = []
        for of_level in zip(*blocks, strict=True):
            ends = list(accumulate(map(len, of_level), initial=0))
            rows.append({name: slice(*ends[i : i + 2]) for i, (_, name) in enumerate(parts)})
        sizes = {block.shape[1] for of_view in blocks for block in of_view}
        if len(sizes) > 1:
            raise InputError(f"the views have embeddings of different sizes {sorted(sizes)}: they mix models")
        return cls(levels, [torch.cat(of_level) for of_level in zip(*blocks, strict=True)], rows).checked()

    def of_view(self, view_name: str) -> list[Tensor]:
        """S x [R, D], the embeddings of the regions of one view."""
        return [part[rows[view_name]] for part, rows in zip(self.of_levels, self.rows, strict=True)]

    def checked(self) -> RegionEmbeddings:
        """Themselves, if they can be coded.

        Raises:
            InputError: see ``of``.
        """
        sizes = {level: part.shape[1] for level, part in zip(self.levels, self.of_levels, strict=True)}
        if len(set(sizes.values())) > 1:
            raise InputError(f"the levels have embeddings of different sizes {sizes}: they mix models")
        for level, part in zip(self.levels, self.of_levels, strict=True):
            if not len(part):
                raise InputError(f"level {level!r} has no regions in any view; every level needs some")
            if not part.any():
                raise InputError(
                    f"level {level!r} has only zero embeddings, as black photographs get from --embedder colors; check "
                    "the photographs, or extract the regions with a CLIP model"
                )
        return self


@dataclass(frozen=True, eq=False)
class RegionCodes:
    """One codebook and one set of codes a level.

    Attributes:
        codebook: [S, L, D] float32.
        codes: per level, of the regions of all views.
        rows: per level, the rows of each view in them.
        reports: per level, the report of the coding as JSON values.
        embeddings: per level [R, D] float16 of the regions, from which things are made again when views change; none
            where nobody wants things.
    """

    codebook: Tensor  # [S, L, D]
    codes: Sequence[SparseCodes]
    rows: Rows
    reports: Sequence[dict[str, Any]]
    embeddings: Sequence[Tensor] = ()

    @property
    def n_atoms(self) -> int:
        return self.codebook.shape[1]

    def keep(self, sums: RegionSums, key: str) -> None:
        """Keep them beside region sums, under a key of everything they depend on."""
        tensors = {"codebook": self.codebook}
        for s, level in enumerate(self.codes):
            tensors |= {f"indices.{s}": level.indices, f"weights.{s}": level.weights}
        tensors |= {f"embeddings.{s}": rows for s, rows in enumerate(self.embeddings)}
        rows = [{name: [part.start, part.stop] for name, part in level.items()} for level in self.rows]
        sums.keep_codes({"key": key, "rows": rows, "reports": list(self.reports)}, tensors)

    @classmethod
    def kept(cls, sums: RegionSums, key: str | None = None) -> RegionCodes | None:
        """Those kept beside region sums; None where there are none, or others than those of a key.

        Raises:
            InputError: they make no sense.
        """
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
            raise InputError(f"{sums.path}: the codes in it make no sense ({error}); build again") from error

    def without(self, view_name: str) -> RegionCodes:
        """The same, but for one view, whose codes stay unused.

        Raises:
            InputError: there is no such view.
        """
        if view_name not in self.rows[0]:
            known = ", ".join(list(self.rows[0])[:5])
            raise InputError(f"the view {view_name!r} is not in the field; there are {known}, ...")
        rows = [{name: part for name, part in level.items() if name != view_name} for level in self.rows]
        return replace(self, rows=rows)

    def compacted(self) -> RegionCodes:
        """The same, where most of the codes are unused: without these. Else itself."""
        used = sum(part.stop - part.start for level in self.rows for part in level.values())
        if 2 * used >= sum(map(len, self.codes)):
            return self
        codes, rows, chosen = [], [], []
        for level, places in zip(self.codes, self.rows, strict=True):
            chosen.append(torch.cat([torch.arange(part.start, part.stop) for part in places.values()]))
            codes.append(level.rows(chosen[-1]))
            ends = accumulate(part.stop - part.start for part in places.values())
            rows.append(
                {
                    name: slice(end - (part.stop - part.start), end)
                    for (name, part), end in zip(places.items(), ends, strict=True)
                }
            )
        embeddings = [part[own] for part, own in zip(self.embeddings, chosen, strict=False)]
        return RegionCodes(self.codebook, codes, rows, self.reports, embeddings)

    def with_view(
        self, view_name: str, codes: Sequence[SparseCodes], codebook: Tensor, embeddings: Sequence[Tensor]
    ) -> RegionCodes:
        """One view more, or with other regions.

        Args:
            view_name: its name.
            codes: per level, of its regions, over the atoms of ``codebook``.
            codebook: [S, L', D], whose first atoms are those of before.
            embeddings: per level [R, D], of its regions.
        """
        longer, rows = [], []
        for old, new, places in zip(self.codes, codes, self.rows, strict=True):
            longer.append(joined(old, new))
            rows.append({**places, view_name: slice(len(old), len(old) + len(new))})
        parts = zip(self.embeddings, embeddings, strict=False)
        known = [torch.cat([of_level, own.cpu().half()]) for of_level, own in parts]
        return RegionCodes(codebook, longer, rows, self.reports, known)


def learn_region_codes(
    sums: RegionSums,
    embeddings: RegionEmbeddings,
    settings: BuildSettings,
    device: torch.device,
    progress: Progress = no_progress,
) -> RegionCodes:
    """Codes of every level; kept beside the sums as soon as they are known.

    Codes that are there already, of these embeddings and settings, are used as they are.
    """
    key = inputs_digest("", [], embeddings, settings.of_codes)
    kept = RegionCodes.kept(sums, key)
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
        # Seconds would make two equal builds write different bytes.
        report = {name: value for name, value in asdict(book.report).items() if name != "seconds"}
        learned.append((book.atoms.cpu(), book.codes.to("cpu"), report))
    atoms, codes, reports = zip(*learned, strict=True)
    known = [rows.cpu().half() for rows in embeddings.of_levels] if settings.things else []
    coded = RegionCodes(torch.stack(atoms), codes, embeddings.rows, reports, known)
    if sums.writable:
        coded.keep(sums, key)
    return coded


def joined(first: SparseCodes, second: SparseCodes) -> SparseCodes:
    """The rows of both, over the atoms of the second; shorter codes are filled up with zeros."""
    k = max(first.k, second.k)
    indices, weights = [], []
    for codes in (first, second):
        fill = (0, k - codes.k)
        indices.append(
            torch.nn.functional.pad(codes.indices.long(), fill)
        )  # torch joins few things of type uint16
        weights.append(torch.nn.functional.pad(codes.weights, fill))
    return SparseCodes(torch.cat(indices).to(second.indices.dtype), torch.cat(weights), second.n_atoms)


def inputs_digest(
    fingerprint: str, cameras: Sequence[Camera], embeddings: RegionEmbeddings, settings: Mapping[str, Any]
) -> str:
    """SHA-256 of everything that a result depends on but the label maps, which have a digest for each view.

    Args:
        fingerprint: of the Gaussians.
        cameras: the views.
        embeddings: of their regions.
        settings: plain JSON values.
    """
    digest = hashlib.sha256(json.dumps([VERSION, fingerprint, settings], sort_keys=True).encode())
    for camera in cameras:
        digest.update(json.dumps([camera.name, camera.fingerprint()]).encode())
    for level, of_level, rows in zip(embeddings.levels, embeddings.of_levels, embeddings.rows, strict=True):
        ends = {name: part.stop for name, part in rows.items()}
        digest.update(json.dumps([level, list(of_level.shape), ends]).encode())
        digest.update(of_level.contiguous().numpy().data)
    return digest.hexdigest()
