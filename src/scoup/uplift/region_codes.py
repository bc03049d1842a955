"""Codes of the regions of all views, with their codebook: what the vote multiplies the region sums with."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.scene.codes import SparseCodes
from scoup.uplift.region_sums import RegionSums


@dataclass(frozen=True, eq=False)
class RegionCodes:
    """One codebook and one set of codes a level.

    Attributes:
        codebook: [S, L, D] float32.
        codes: per level, of the regions of all views.
        rows: per level, the rows of each view in them.
        reports: per level, the report of the coding as JSON values.
    """

    codebook: Tensor  # [S, L, D]
    codes: Sequence[SparseCodes]
    rows: Sequence[Mapping[str, slice]]
    reports: Sequence[dict[str, Any]]

    @property
    def n_atoms(self) -> int:
        return self.codebook.shape[1]

    def keep(self, sums: RegionSums, key: str) -> None:
        """Keep them beside region sums, under a key of everything they depend on."""
        tensors = {"codebook": self.codebook}
        for s, level in enumerate(self.codes):
            tensors |= {f"indices.{s}": level.indices, f"weights.{s}": level.weights}
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
            return cls(codebook, codes, rows, list(header["reports"]))
        except (KeyError, TypeError, ValueError, AttributeError, IndexError, InputError) as error:
            raise InputError(f"{sums.path}: the codes in it make no sense ({error}); build again") from error

    def without(self, view_name: str) -> RegionCodes:
        """The same, but for one view, whose codes stay unused."""
        rows = [{name: part for name, part in level.items() if name != view_name} for level in self.rows]
        return RegionCodes(self.codebook, self.codes, rows, self.reports)

    def with_view(self, view_name: str, codes: Sequence[SparseCodes], codebook: Tensor) -> RegionCodes:
        """One view more, or with other regions.

        Args:
            view_name: its name.
            codes: per level, of its regions, over the atoms of ``codebook``.
            codebook: [S, L', D], whose first atoms are those of before.
        """
        longer, rows = [], []
        for old, new, places in zip(self.codes, codes, self.rows, strict=True):
            longer.append(joined(old, new))
            rows.append({**places, view_name: slice(len(old), len(old) + len(new))})
        return RegionCodes(codebook, longer, rows, self.reports)


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
