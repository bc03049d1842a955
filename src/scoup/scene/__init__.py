"""The data of a scene: Gaussians, cameras, regions and sparse codes, as frozen dataclasses of tensors.

They check themselves when they are made; beside them stand the few functions on them that several rooms need:
neighbours, rotations, directions, and products that give the same bytes everywhere.
"""

from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import (
    SparseCodes,
    check_atoms,
    code_arrays,
    float32_products,
    index_dtype,
    rows_of,
    signed,
    stable_products,
)
from scoup.scene.directions import (
    checked_direction,
    estimate_up,
    normalise_embeddings,
    quats_of_rotations,
    query_vectors,
    rotation_matrices,
)
from scoup.scene.gaussians import MAX_SH_DEGREE, SH_C0, Gaussians, chosen_rows
from scoup.scene.harmonics import sh_basis
from scoup.scene.neighbours import linked_parts, nearest_points
from scoup.scene.regions import (
    LEAST_EMBEDDING,
    LEVELS,
    Detections,
    RegionMap,
    Regions,
    codes_problem,
    resize_labels,
)
from scoup.scene.sanity_checks import sanity_problems

__all__ = [
    "LEAST_EMBEDDING",
    "LEVELS",
    "MAX_SH_DEGREE",
    "SH_C0",
    "Camera",
    "Cameras",
    "Detections",
    "Gaussians",
    "RegionMap",
    "Regions",
    "SparseCodes",
    "check_atoms",
    "checked_direction",
    "chosen_rows",
    "code_arrays",
    "codes_problem",
    "estimate_up",
    "float32_products",
    "index_dtype",
    "linked_parts",
    "nearest_points",
    "normalise_embeddings",
    "quats_of_rotations",
    "query_vectors",
    "resize_labels",
    "rotation_matrices",
    "rows_of",
    "sanity_problems",
    "sh_basis",
    "signed",
    "stable_products",
]
