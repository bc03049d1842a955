"""Fields made from a field: on another device, or of other Gaussians."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from scoup.scene.gaussians import Gaussians
from scoup.scene.things import ThingTable

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField


def moved_field(field: LanguageField, device: torch.device | str) -> LanguageField:
    """Return a field on a device; ``LanguageField.to`` documents it."""
    place = torch.empty(0, device=device).device
    parts = [field.code_indices, field.code_weights, field.codebook]
    parts += [field.gaussians.means] if field.has_geometry else []
    if all(part.device == place for part in parts):
        return field
    moved = type(field)(
        field.code_indices.to(device),
        field.code_weights.to(device),
        field.codebook.to(device),
        field.info,
        geometry_path=field.geometry_path,
        cameras=field.cameras,
        thing_table=None if field.thing_table is None else field.thing_table.to(device),
    )
    moved.path = field.path
    moved.keep_encoder_of(field)
    if field.has_geometry:
        moved.attach(field.gaussians.to(device), known=True)
    return moved


def field_on(
    field: LanguageField,
    gaussians: Gaussians,
    indices: Tensor,
    weights: Tensor,
    thing_table: ThingTable | None,
) -> LanguageField:
    """Return a field of these Gaussians and their codes, with codebook, cameras and encoder of another."""
    provenance = {**field.info.provenance, "selected_from": field.fingerprint}
    info = replace(
        field.info, fingerprint=gaussians.fingerprint(), n_gaussians=len(gaussians), provenance=provenance
    )
    made = type(field)(indices, weights, field.codebook, info, cameras=field.cameras, thing_table=thing_table)
    made.attach(gaussians, known=True)
    made.keep_encoder_of(field)
    return made
