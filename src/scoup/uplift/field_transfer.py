"""``transfer``: the codes of a field on another splat, such as the field's own after an edit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from torch import Tensor

from scoup.base import InputError, check_arguments
from scoup.field import NO_THING, Field
from scoup.scene import Gaussians, signed
from scoup.uplift import constants

Own = TypeVar("Own", bound=Field)


def transfer(field: Own, gaussians: Gaussians, *, geometry_path: str | Path | None = None) -> Own:
    """Return the field of another splat in the same frame: deleted from, added to, reordered, or rounded by a format.

    Each Gaussian gets the codes and things of the nearest Gaussian of the field that it lies in: its centre is no
    further away than the largest scale of that Gaussian. Gaussians that lie in none get no code. Nothing is rasterised
    and no view votes.

    Args:
        field: not changed. Its geometry is read.
        gaussians: M of them, of the other splat.
        geometry_path: file of the other splat, recorded in the new field.

    Raises:
        InputError: no Gaussian lies in one of the field's.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> edited = field.gaussians.select(torch.arange(100))  # as an editor of splats leaves it
        >>> len(scoup.transfer(field, edited))
        100
    """
    check_arguments("transfer", field=(field, Field), gaussians=(gaussians, Gaussians))
    device = field.codebook.device
    gaussians = gaussians.to(device)
    source = source_rows(field.gaussians, gaussians).to(device)
    n_coded = int((source >= 0).sum())
    if not n_coded:
        raise InputError(
            f"{geometry_path or 'the edited splat'}: none of its Gaussians lies in one of the field's; use a splat in "
            "the frame of the field's own, or build the field again"
        )
    things = field.thing_table
    if things is not None:
        things = replace(things, owners=_carry_over(things.owners, source, NO_THING))
    record = {"from": field.fingerprint, "coded": n_coded, "not_coded": len(gaussians) - n_coded}
    return field.moved_to(
        gaussians,
        {"transferred": record},
        code_indices=_carry_over(field.code_indices, source),
        code_weights=_carry_over(field.code_weights, source),
        geometry_path=None if geometry_path is None else Path(geometry_path),
        thing_table=things,
    )


def source_rows(before: Gaussians, after: Gaussians) -> Tensor:
    """Return [M] int64: the row ``before`` whose codes each Gaussian ``after`` gets (``transfer``); -1 for none."""
    from scipy.spatial import KDTree

    old, new = (np.flatnonzero(scene.finite().cpu().numpy()) for scene in (before, after))
    sources = np.full(len(after), -1)
    if len(old) and len(new):
        places, targets = (scene.means.double().cpu().numpy() for scene in (before, after))
        count = min(constants.NEAREST, len(old))
        of_query = KDTree(places[old]).query(targets[new], k=count, workers=-1)
        far, near = (np.asarray(array).reshape(len(new), count) for array in of_query)
        inside = far <= before.scales.amax(1).double().cpu().numpy()[old[near]]
        first = inside.argmax(1)[:, None]
        rows = np.take_along_axis(old[near], first, 1)[:, 0]
        sources[new] = np.where(inside.any(1), rows, -1)
    return torch.from_numpy(sources)


def _carry_over(rows: Tensor, source: Tensor, others: int = 0) -> Tensor:
    """Return rows [M, ...] such as codes or owners; ``others`` for Gaussians without a source."""
    carried = signed(rows)[source.clamp(min=0)]
    carried[source < 0] = others
    return carried.view(rows.dtype)
