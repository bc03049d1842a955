"""How many instances of each word a rendered scene shows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from benchmarks.scenes import find_layout
from scoup.scene.cameras import Camera
from scoup_lab.synthetic.art.meshes import merged
from scoup_lab.synthetic.art.zbuffer import visible_faces

LEAST_PIXELS, LEAST_VIEWS = 169, 2
"""An instance counts if so many of its pixels are visible in so many of the views that the field was built from."""


def true_counts(
    layout: str, cameras: Iterable[Camera], meanings: Mapping[str, Sequence[str]]
) -> dict[str, int]:
    """Return the number of visible instances of each word.

    Args:
        layout: of ``benchmarks.scenes``.
        cameras: of the views.
        meanings: word -> the names of the layout's things that it means.
    """
    things = find_layout(layout).things()
    meshes = [thing.mesh(piece) for thing in things for piece in thing.pieces]
    owners = np.repeat(np.arange(len(things)), [len(thing.pieces) for thing in things])
    of_face = np.append(np.repeat(owners, [len(mesh.faces) for mesh in meshes]), len(things))
    whole = merged(meshes)
    views = np.zeros(len(things) + 1, int)
    for camera in cameras:
        seen = of_face[visible_faces(whole.vertices, whole.faces, camera)]
        views += np.bincount(seen.ravel(), minlength=len(things) + 1) >= LEAST_PIXELS
    counted = views[:-1] >= LEAST_VIEWS
    return {
        word: sum(bool(counted[number]) for number, thing in enumerate(things) if thing.name in names)
        for word, names in meanings.items()
    }
