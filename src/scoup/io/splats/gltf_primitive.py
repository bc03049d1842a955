"""The Gaussians of one primitive of a glTF file (KHR_gaussian_splatting), in its own frame and in the world's."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from scoup.base.errors import ScoupWarning
from scoup.io.splats.activation import unit_quats
from scoup.io.splats.axes import Columns, half_turn
from scoup.io.splats.gltf_accessors import Integers, accessor_count, read_accessor
from scoup.io.splats.gltf_document import GltfDocument, extension
from scoup.io.splats.gltf_nodes import SPLATS, Similarity
from scoup.io.splats.rotation import rotated_quats, rotated_sh
from scoup.io.splats.spz import spz_columns

SH_DEGREE = 3  # the highest that the extension knows
SPZ = f"{SPLATS}_compression_spz"  # also with a version of .spz behind it
EXPORT_PLAIN = "export it uncompressed (with KHR_gaussian_splatting alone), or as PLY"
DEFAULTS = {
    "kernel": "ellipse",
    "colorSpace": "srgb_rec709_display",
    "projection": "perspective",
    "sortingMethod": "cameraDistance",
}
"""Properties of the extension and the values that they have for Gaussians of 3DGS."""


def read_primitive(document: GltfDocument, primitive: dict[str, Any]) -> Columns:
    """Return the values of one primitive in its own frame."""
    packed = _check_primitive(document, primitive)
    if packed is not None:
        columns = spz_columns(document.path, packed)
        if columns["sh"].shape[1] > (SH_DEGREE + 1) ** 2:
            raise document.error(
                f"has SH of a degree above {SH_DEGREE}, which glTF does not know", EXPORT_PLAIN
            )
        return half_turn(columns, "z")  # to left, up, forward
    attributes = primitive.get("attributes")
    if not isinstance(attributes, dict) or "POSITION" not in attributes:
        raise document.error("its Gaussians have no POSITION")
    count = accessor_count(document, attributes["POSITION"], "POSITION")

    def column(name: str, kind: str, integers: Integers = "none") -> np.ndarray:
        if name not in attributes:
            raise document.error(
                f"its Gaussians have no {name}", "export it again with the ratified extension"
            )
        if accessor_count(document, attributes[name], name) != count:
            raise document.error(f"POSITION and {name} have different counts")
        return read_accessor(document, attributes[name], kind, name, integers)

    quats = column(f"{SPLATS}:ROTATION", "VEC4", "normalised")
    coefficients = [column(name, "VEC3") for name in sh_names(_degree(attributes))]
    return {
        "means": column("POSITION", "VEC3", "any"),
        "quats": unit_quats(np.roll(quats, 1, axis=1)),
        "scales": np.abs(column(f"{SPLATS}:SCALE", "VEC3", "any")),
        "opacities": column(f"{SPLATS}:OPACITY", "SCALAR", "normalised")[:, 0].clip(0.0, 1.0),
        "sh": np.stack(coefficients, axis=1),
    }


def _check_primitive(document: GltfDocument, primitive: dict[str, Any]) -> bytes | None:
    """Refuse what is not read; return the bytes of a .spz file, if the Gaussians are compressed so."""
    if primitive.get("mode", 4) != 0:
        raise document.error("its Gaussians are not points (mode 0)", "export it again")
    splats = extension(primitive, SPLATS) or {}
    inner = splats.get("extensions")
    packed = None
    for name, item in inner.items() if isinstance(inner, dict) else ():
        if name.startswith(SPZ) and isinstance(item, dict):
            packed = bytes(document.view(item.get("bufferView"), "the SPZ data")[0])
        elif "compression" in name:
            raise document.error(f"its Gaussians are compressed ({name[:60]!a})", EXPORT_PLAIN)
    for name, usual in DEFAULTS.items():
        if splats.get(name, usual) != usual:
            warnings.warn(
                f"{document.path}: its {name} is {ascii(splats[name])[:60]}; it is read as if it were {usual}",
                ScoupWarning,
                stacklevel=6,
            )
    return packed


def _degree(attributes: dict[str, Any]) -> int:
    """Return the highest degree that has a coefficient; missing coefficients are found when they are read."""
    return max(
        degree
        for degree in range(SH_DEGREE + 1)
        if not degree or any(name.startswith(f"{SPLATS}:SH_DEGREE_{degree}_") for name in attributes)
    )


def sh_names(degree: int) -> list[str]:
    """Return the attributes of all coefficients up to a degree, in our order."""
    return [
        f"{SPLATS}:SH_DEGREE_{level}_COEF_{order}"
        for level in range(degree + 1)
        for order in range(2 * level + 1)
    ]


def transformed(columns: Columns, similarity: Similarity) -> Columns:
    """Return the values of a primitive in the frame of the world, computed in float64 and rounded once."""
    with np.errstate(all="ignore"):
        means = columns["means"].astype(np.float64) @ (similarity.scale * similarity.rotation).T
        return {
            "means": (means + similarity.translation).astype(np.float32),
            "quats": rotated_quats(columns["quats"], similarity.rotation),
            "scales": (columns["scales"].astype(np.float64) * similarity.scale).astype(np.float32),
            "opacities": columns["opacities"],
            "sh": rotated_sh(columns["sh"], similarity.rotation),
        }
