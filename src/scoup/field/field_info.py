"""The description of a language field, and checks of its tensors."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from torch import Tensor

from scoup.base import InputError, WorldFrame
from scoup.field.checks import CODES, check_codes, tensor_array
from scoup.field.thing_table import ThingTable


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
    world: WorldFrame = field(default_factory=WorldFrame)
    """Its frame in the world."""


def check_parts(
    code_indices: Tensor, code_weights: Tensor, codebook: Tensor, info: FieldInfo, things: ThingTable | None
) -> None:
    """Check that codes, codebook, description and things of a field fit together; see ``LanguageField``."""
    sides = {"N": info.n_gaussians, "S": len(info.levels)}
    arrays = (tensor_array(tensor) for tensor in (code_indices, code_weights, codebook))
    check_codes(dict(zip(CODES, arrays, strict=True)), sides)
    if things is not None:
        shapes = {"N S": things.owners.shape, "D": things.embeddings.shape[1:]}
        for letters, shape in shapes.items():
            wanted = [sides[letter] for letter in letters.split()]
            if list(shape) != wanted:
                raise InputError(f"things of [{letters}] = {list(shape)} do not fit codes of {wanted}")
