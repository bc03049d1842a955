"""The card of a language field in a notebook."""

from __future__ import annotations

from scoup.base.counts import listed
from scoup.base.errors import InputError
from scoup.base.html import PREVIEW, card
from scoup.pictures.colors import Picture
from scoup.query.coded_scene import CodedScene
from scoup.query.drawing import code_drawing


def field_card(field: CodedScene) -> str:
    """Return the HTML of the codes in one view and of the field's facts."""
    names = () if field.cameras is None else field.cameras.names
    facts = {
        "levels": ", ".join(field.levels),
        "atoms": field.n_atoms,
        "embeddings": f"{field.dim} dimensions, {field.embedding_model or 'an unnamed model'}",
        "cameras": f"{len(names):,}: {listed(names, 4)}" if names else 0,
        "file": field.path or "not saved",
    }
    return card(f"Language field of {len(field):,} Gaussians", facts, _codes(field))


def _codes(field: CodedScene) -> Picture | None:
    """The codes of the middle level in the first camera; None without a camera or geometry."""
    if field.cameras is None or not len(field.cameras) or not len(field):
        return None
    camera = field.cameras[0]
    scale = min(1.0, PREVIEW[0] / camera.width)
    camera = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
    try:
        projection = field.project(camera)
    except InputError:  # the geometry was moved; show the facts alone
        return None
    return code_drawing(field, len(field.levels) // 2, plain=True)(camera, projection)
