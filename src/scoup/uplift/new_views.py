"""Regions of a view that a codebook was not learned from: their codes, and atoms for what it explains badly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.coding.codebook import check_new_atoms, encode_rows, learn_atoms
from scoup.coding.encode import encode
from scoup.scene.codes import SparseCodes
from scoup.scene.directions import normalise_embeddings
from scoup.scene.regions import Regions

MANY = 0.3  # share of a view's regions; about a tenth are badly explained where nothing is new


@dataclass(frozen=True, eq=False)
class CodedView:
    """The regions of one view under a field's codebook."""

    codes: list[SparseCodes]  # per level, over L' atoms
    codebook: Tensor  # [S, L', D] float32; begins with the field's own atoms
    n_new: list[int]  # atoms added per level
    n_regions: int  # at all levels, without those of norm zero
    n_badly_explained: (
        int | None
    )  # by the field's own atoms; None if the field does not record what to expect


def view_embeddings(view_name: str, regions: Regions, levels: Sequence[str], dim: int) -> list[Tensor]:
    """Return S x [R, D], the embeddings of a view's regions; an InputError if levels or size are not the field's."""
    if tuple(regions.levels) != tuple(levels):
        raise InputError(
            f"the regions have levels {list(regions.levels)}, the field {list(levels)}; "
            "use regions made as the field's were"
        )
    embeddings = [regions.load_embeddings(view_name, level) for level in levels]
    for rows in embeddings:
        if rows.shape[1] != dim:
            raise InputError(
                f"the regions of {view_name!r} have embeddings of {rows.shape[1]} dimensions, the field {dim}; "
                "extract them with the model that the field was built with"
            )
    return embeddings


def code_view(
    codebook: Tensor,
    embeddings: Sequence[Tensor],
    k: int,
    thresholds: Sequence[float] | None,
    new_atoms: int = 0,
) -> CodedView:
    """Code a view's regions, and add at most ``new_atoms`` atoms per level for those badly explained.

    Args:
        codebook: [S, L, D] float32.
        embeddings: S x [R_s, D].
        k: most atoms of a code.
        thresholds: per level, the cosine below which a region is badly explained (``explained_thresholds``); None if
            not known.
        new_atoms: 0 or more; needs ``thresholds``.
    """
    check_new_atoms(codebook.shape[1], new_atoms)
    if thresholds is None and new_atoms:
        raise InputError(
            "this field does not record how well its codebook explains regions (provenance), so none counts as badly "
            "explained; build it again, or add the view with `new_atoms=0`"
        )
    rows = [normalise_embeddings(of_level) for of_level in embeddings]
    least = [0.0] * len(rows) if thresholds is None else thresholds
    encoded = [
        encode_rows(r, atoms, k, cosine) for r, atoms, cosine in zip(rows, codebook, least, strict=True)
    ]
    new = [
        learn_atoms(r[coded.badly_explained], atoms, k, new_atoms)
        for r, atoms, coded in zip(rows, codebook, encoded, strict=True)
    ]
    codes = [coded.codes for coded in encoded]
    if any(len(atoms) for atoms in new):
        codebook = append_atoms(codebook, new)
        codes = [encode(r, atoms, k) for r, atoms in zip(rows, codebook, strict=True)]
    badly_explained = sum(int(coded.badly_explained.sum()) for coded in encoded)
    return CodedView(
        codes,
        codebook,
        [len(atoms) for atoms in new],
        sum(int(r.any(1).sum()) for r in rows),
        None if thresholds is None else badly_explained,
    )


def append_atoms(codebook: Tensor, new: Sequence[Tensor]) -> Tensor:
    """Append S x [M_s, D] atoms to a codebook [S, L, D].

    Shorter levels are padded with zero atoms, which no code uses; the next call replaces these first.
    """
    levels = []
    for atoms, more in zip(codebook, new, strict=True):
        filled = atoms.any(1).nonzero()
        levels.append(torch.cat([atoms[: int(filled[-1]) + 1 if len(filled) else 0], more]))
    count = max(codebook.shape[1], *(len(level) for level in levels))
    grown = codebook.new_zeros(len(levels), count, codebook.shape[2])
    for place, level in zip(grown, levels, strict=True):
        place[: len(level)] = level
    return grown


def explained_thresholds(provenance: dict[str, Any], levels: Sequence[str]) -> list[float] | None:
    """Return, per level, the cosine below which its codebook explains a region badly; None if not recorded."""
    try:
        return [float(provenance["coding"][level]["explained_from"]) for level in levels]
    except (KeyError, TypeError, ValueError):
        return None
