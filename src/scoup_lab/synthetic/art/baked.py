"""Things of a layout, read from a file.

They were modelled by a program, once: the folders ``synthetic/art`` and ``benchmarks/scenes`` of commit 8cc64a2e have
it. What it made is kept, exactly, in one .npz for each layout:

* ``vertices``, ``normals`` [3, V] float64 and ``faces`` [3, F] uint16 of all shapes, one after the other; faces count
  the vertices of their own shape
* ``n_vertices``, ``n_faces`` [shapes] uint16
* ``things``: JSON text. The fields of every ``Thing`` and ``Piece`` by their names. A piece lists its shapes, each with
  the moves, an offset and a rotation, that put it into its place one after the other, and has the number of its paint
  (``paints.paint_of``)
"""

from __future__ import annotations

import functools
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scoup_lab.synthetic.art.meshes import Mesh, merged
from scoup_lab.synthetic.art.paints import Paint, paint_of
from scoup_lab.synthetic.art.things import Piece, Thing


@functools.cache
def read_things(path: Path) -> tuple[Thing, ...]:
    """Return all things of a layout's file, placed; z is up, metres."""
    with np.load(path) as file:
        content = json.loads(str(file["things"]))
        vertices, normals = (_split(file[name], file["n_vertices"]) for name in ("vertices", "normals"))
        faces = _split(file["faces"].astype(np.int64), file["n_faces"])
    shapes = [Mesh(*shape) for shape in zip(vertices, normals, faces, strict=True)]
    paints = [paint_of(graph) for graph in content["paints"]]
    return tuple(_thing(fields, shapes, paints) for fields in content["things"])


def _split(columns: np.ndarray, counts: np.ndarray) -> list[np.ndarray]:
    """Return [3, n] columns as rows [count, 3] of each shape."""
    return np.split(columns.T.copy(), np.cumsum(counts, dtype=np.int64)[:-1])


def _thing(fields: dict[str, Any], shapes: Sequence[Mesh], paints: Sequence[Paint]) -> Thing:
    pieces = tuple(_piece(piece, shapes, paints) for piece in fields["pieces"])
    turn, position = (np.array(fields[name]) for name in ("turn", "place"))
    return Thing(**{**fields, "pieces": pieces, "turn": turn, "place": position})


def _piece(fields: dict[str, Any], shapes: Sequence[Mesh], paints: Sequence[Paint]) -> Piece:
    fields = dict(fields)
    meshes = []
    for number, *moves in fields.pop("shapes"):
        mesh = shapes[number]
        for offset, turn in moves:
            mesh = mesh.moved(offset, None if turn is None else np.array(turn))
        meshes.append(mesh)
    return Piece(mesh=merged(meshes), **{**fields, "paint": paints[fields["paint"]]})
