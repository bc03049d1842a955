"""The description of a language field, and checks of its tensors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup.base.errors import InputError
from scoup.scene.codes import index_dtype
from scoup.scene.things import ThingTable


@dataclass(frozen=True)
class FieldInfo:
    """The description of a field, without its tensors.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> scoup.FieldInfo(("s", "m"), "my/model", gaussians.fingerprint(), len(gaussians)).raster_preset
        'inria'
    """

    levels: tuple[str, ...]
    """Level names, fine to coarse."""
    embedding_model: str
    """Id of the model whose embeddings were coded; queries must come from the same model."""
    fingerprint: str
    """Of the geometry that the field belongs to (``Gaussians.fingerprint``)."""
    n_gaussians: int
    """N of that geometry."""
    raster_preset: str = "inria"
    """Rasteriser constants for building and rendering."""
    provenance: dict[str, Any] = field(default_factory=dict)
    """Software version, settings, digests of inputs, coding reports, as plain JSON values."""
    words: Path | None = None
    """The word table that encodes texts; None: ``embedding_model`` does."""


def check_codes(code_indices: Tensor, code_weights: Tensor, codebook: Tensor, info: FieldInfo) -> None:
    """Check the codes of a field; see ``LanguageField``."""
    shape = tuple(code_indices.shape)
    if len(shape) != 3 or shape != tuple(code_weights.shape) or shape[0] != info.n_gaussians:
        raise InputError(
            f"code indices {list(shape)} and weights {list(code_weights.shape)} must both be "
            f"[{info.n_gaussians}, S, K]"
        )
    if codebook.dim() != 3 or not len(codebook) == shape[1] == len(info.levels):
        raise InputError(
            f"codebook {list(codebook.shape)} does not fit {shape[1]} levels of codes and "
            f"{len(info.levels)} level names"
        )
    if 0 in (*shape[1:], *codebook.shape):
        raise InputError(f"codes {list(shape)} and codebook {list(codebook.shape)} are empty")
    n_atoms = codebook.shape[1]
    if code_indices.dtype != index_dtype(n_atoms):
        raise InputError(f"code indices are {code_indices.dtype}, expected {index_dtype(n_atoms)}")
    # The smallest and the largest are not finite if any is not, and need no copy of the weights.
    low, high = torch.aminmax(code_weights) if code_weights.numel() else torch.zeros(2)
    if not torch.isfinite(codebook).all() or not bool(torch.isfinite(low) & torch.isfinite(high)):
        raise InputError("codebook or code weights have values that are not finite")
    if low < 0:
        raise InputError("a code weight is negative")
    # torch finds no largest of uint16.
    indices = code_indices if code_indices.dtype == torch.uint8 else code_indices.int()
    if indices.numel() and int(indices.max()) >= n_atoms:
        raise InputError(f"a code index is beyond the {n_atoms} atoms of the codebook")


def check_things(things: ThingTable, codes: Sequence[int], dim: int) -> None:
    """Check that things belong to codes [N, S, K] and embeddings of some size."""
    if tuple(things.owners.shape) != tuple(codes[:2]) or things.embeddings.shape[1] != dim:
        raise InputError(
            f"things of {list(things.owners.shape)} Gaussians and levels and {things.embeddings.shape[1]} dimensions "
            f"do not fit codes {list(codes)} of {dim} dimensions"
        )
