"""Registration of two captures of one place: the similarity transform between their frames, from their things.

Things of both captures that look alike are candidate pairs. RANSAC over triples of pairs finds the transform under
which most things agree, in position and size. ICP on the Gaussians of these things refines it. Some things of any two
scenes agree by chance, so a transform needs more. Ours; measured in docs/many_scenes.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from scoup.field import Field
from scoup.query import constants
from scoup.query.boxes import PointSets
from scoup.query.things import Thing

if TYPE_CHECKING:
    from scipy.spatial import KDTree

Array = NDArray[np.floating[Any]]


@dataclass(frozen=True, eq=False)
class Capture:
    """A field and its named things."""

    field: Field
    things: list[Thing]

    @cached_property
    def points(self) -> PointSets:
        """Some Gaussians of each thing, without strays."""
        members = [thing.gaussians for thing in self.things]
        return PointSets.of(self.field.gaussians, members).sample(constants.LOOKED_FOR)

    @cached_property
    def embeddings(self) -> Array:
        """[rows of the table, D]."""
        table = self.field.thing_table
        assert table is not None
        return table.embeddings.double().cpu().numpy()

    @cached_property
    def solid(self) -> NDArray[np.int64]:
        """Gaussians that something can lie on."""
        gaussians = self.field.gaussians
        return np.flatnonzero(
            (gaussians.finite() & (gaussians.opacities >= constants.LEAST_OPACITY)).cpu().numpy()
        )

    @cached_property
    def tree(self) -> KDTree:
        from scipy.spatial import KDTree

        return KDTree(self.field.gaussians.means.double().cpu().numpy()[self.solid])


Source = Literal["transform passed", "same frame", "registered"]


@dataclass(frozen=True, eq=False)
class Registration:
    """A transform between the frames of two captures, and how many things agree under it."""

    transform: Array
    """[4, 4] from the frame of the new capture to that of the old one."""
    source: Source
    """Where the transform comes from."""
    agreeing: int
    """Things that are in one place, and of one size, in both captures."""
    things: int
    """Things of one capture, the one with fewer; the best seen of them if they are many."""
    residual: float | None
    """Median distance between Gaussians of these things and those of the other capture, in units of the old one."""

    @property
    def plausible(self) -> bool:
        """Return whether more things agree than by chance."""
        least = constants.LEAST_AGREEING if self.source == "registered" else 1
        return self.agreeing >= least + constants.AGREEING_SHARE * self.things

    def to_dict(self) -> dict[str, Any]:
        """Return the registration as plain JSON values."""
        scale, matrix = scale_of(self.transform), self.transform.tolist()
        return {"transform": matrix, "scale": scale} | {
            name: getattr(self, name) for name in ("source", "agreeing", "things", "residual")
        }

    def describe(self) -> str:
        """Return "registered, scale 0.42: 85 of 120 things agree, residual 0.004"."""
        residual = "" if self.residual is None else f", residual {self.residual:.2g}"
        scale = f"scale {scale_of(self.transform):.3g}"
        return f"{self.source}, {scale}: {self.agreeing} of {self.things} things agree{residual}"


def scale_of(transform: Array) -> float:
    """Return the scale of a similarity [4, 4]."""
    return float(np.cbrt(np.linalg.det(transform[:3, :3])))


def moved_points(points: Array, transform: Array) -> Array:
    """Return points [M, 3] moved by a transform [4, 4]."""
    return points @ transform[:3, :3].T + transform[:3, 3]


def centred(embeddings: Array, centre: Array) -> Array:
    """Return unit vectors [T, D] of how embeddings differ from the mean of all things."""
    differing = embeddings - centre
    return differing / np.linalg.norm(differing, axis=1, keepdims=True).clip(1e-9)


def register(old: Capture, new: Capture, centre: Array, transform: Array | None = None) -> Registration:
    """Return the registration of two captures under a transform [4, 4], or under the one that their things give;
    ``centre`` [D] is the mean embedding of these.

    It is the identity if that fits the Gaussians as well as the transform found. The same captures give the same bits.
    """
    pairs = _Pairs.of(old, new, centre)
    if transform is not None:
        return _registration(old, new, pairs, transform, "transform passed")
    same = _registration(old, new, pairs, np.eye(4), "same frame")
    rough = pairs.ransac(np.random.default_rng(0))
    found = _registration(old, new, pairs, _refined(old, new, rough, pairs.rows_under(rough)), "registered")
    if not found.plausible:
        return same if same.plausible else found
    # The residual of the things that agree under the one found: others may fit by chance under the identity.
    residual = _nearest(old, new, np.eye(4), pairs.rows_under(found.transform))[2]
    close = float(np.median(residual)) <= constants.SAME_RESIDUAL * (found.residual or 0.0)
    return same if close and same.plausible else found


def _registration(
    old: Capture, new: Capture, pairs: _Pairs, transform: Array, source: Source
) -> Registration:
    rows = pairs.rows_under(transform)
    residual = float(np.median(_nearest(old, new, transform, rows)[2])) if len(rows) else None
    agreeing = min(len(np.unique(side)) for side in rows.T)
    return Registration(transform, source, agreeing, pairs.things, residual)


def _nearest(
    old: Capture, new: Capture, transform: Array, rows: NDArray[np.int64]
) -> tuple[Array, Array, Array]:
    """Return points [M, 3] of the new capture, their nearest ones [M, 3] of the old one, and the distances [M].

    Points of either capture that belong to things ``rows`` [P, 2], each with the nearest Gaussian of the other one.
    """
    some, others = (
        capture.points.means[np.isin(capture.points.owners, rows[:, side])]
        for side, capture in enumerate((old, new))
    )
    to_old, in_old = old.tree.query(moved_points(others, transform))
    to_new, in_new = new.tree.query(moved_points(some, np.linalg.inv(transform)))
    return (
        np.concatenate([others, new.tree.data[in_new]]),
        np.concatenate([old.tree.data[in_old], some]),
        np.concatenate([to_old, to_new * scale_of(transform)]),
    )


def _refined(old: Capture, new: Capture, transform: Array, rows: NDArray[np.int64]) -> Array:
    """Return a transform [4, 4] refined by trimmed ICP on the Gaussians of things ``rows`` [P, 2]."""
    if not len(rows):
        return transform
    for _ in range(constants.ICP_STEPS):
        points, nearest, distances = _nearest(old, new, transform, rows)
        near = distances <= constants.ICP_TRIM * np.median(distances)
        (transform,) = _similarities(points[None], nearest[None], near[None].astype(float))
    return transform


def _similarities(points: Array, targets: Array, weights: Array) -> Array:
    """Return the similarities [B, 4, 4] that move points [B, K, 3] with weights [B, K] onto targets (Umeyama 1991)."""
    shares = weights / weights.sum(1, keepdims=True)
    middles = [np.einsum("bk,bki->bi", shares, each) for each in (points, targets)]
    some, others = points - middles[0][:, None], targets - middles[1][:, None]
    left, spread, right = np.linalg.svd(np.einsum("bk,bki,bkj->bij", shares, others, some))
    signs = np.ones_like(spread)
    signs[:, 2] = np.sign(np.linalg.det(left @ right))  # no reflection
    scales = (spread * signs).sum(1) / np.einsum("bk,bki,bki->b", shares, some, some).clip(1e-30)
    transforms = np.tile(np.eye(4), (len(points), 1, 1))
    transforms[:, :3, :3] = scales[:, None, None] * ((left * signs[:, None]) @ right)
    transforms[:, :3, 3] = middles[1] - np.einsum("bij,bj->bi", transforms[:, :3, :3], middles[0])
    return transforms


@dataclass(frozen=True, eq=False)
class _Pairs:
    """P pairs of an old and a new thing that look alike."""

    rows: NDArray[np.int64]  # [P, 2] of the things
    places: list[Array]  # two of [P, 3], positions
    growth: Array  # [P] logarithm of the old one's size over the new one's
    reach: Array  # [P] up to which distance they are in one place, in units of the old capture
    things: int  # of the capture with fewer, with or without a pair

    @classmethod
    def of(cls, old: Capture, new: Capture, centre: Array) -> _Pairs:
        chosen, vectors, places, sizes = [], [], [], []
        for capture in (old, new):
            seen = sorted(enumerate(capture.things), key=lambda each: -(each[1].n_regions or 0))
            rows, things = zip(*seen[: constants.LANDMARKS], strict=True) if seen else ((), ())
            chosen.append(np.array(rows, np.int64))
            vectors.append(centred(capture.embeddings[[thing.number or 0 for thing in things]], centre))
            places.append(np.array([thing.position.tolist() for thing in things]).reshape(-1, 3))
            sizes.append(np.array([thing.size for thing in things]).clip(1e-12))
        fewer = min(map(len, chosen))
        if not fewer:
            return cls(np.zeros((0, 2), np.int64), [np.zeros((0, 3))] * 2, np.zeros(0), np.zeros(0), 0)
        cosines = vectors[0] @ vectors[1].T
        ranks = np.maximum(*(np.argsort(np.argsort(-cosines, axis), axis) for axis in (0, 1)))
        one, other = np.nonzero((ranks < constants.CANDIDATES) & (cosines >= constants.LIKE[0]))
        extent = np.median(np.linalg.norm(places[0] - np.median(places[0], 0), axis=1))
        reach = np.minimum(constants.SAME_PLACE[0] * sizes[0], constants.SAME_PLACE[1] * extent)
        return cls(
            np.stack([chosen[0][one], chosen[1][other]], 1),
            [places[0][one], places[1][other]],
            np.log(sizes[0][one] / sizes[1][other]),
            reach[one],
            fewer,
        )

    def rows_under(self, transform: Array) -> NDArray[np.int64]:
        """Return the pairs [P, 2] that agree under a transform [4, 4]."""
        return self.rows[self.agree(transform[None])[0]]

    def agree(self, transforms: Array) -> NDArray[np.bool_]:
        """Return boolean [B, P]: the pairs in one place, and of one size, under transforms [B, 4, 4]."""
        points = np.pad(self.places[1], ((0, 0), (0, 1)), constant_values=1.0).T
        squares = np.zeros((len(transforms), len(self.reach)))
        for axis in range(3):
            squares += (transforms[:, axis] @ points - self.places[0][:, axis]) ** 2
        scales = np.log(np.linalg.det(transforms[:, :3, :3]).clip(1e-30))[:, None] / 3
        return (squares <= self.reach**2) & (np.abs(self.growth - scales) <= np.log(constants.RESIZED))

    def counts(self, agree: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Return [B] things that have a pair of boolean [B, P], of the capture with fewer of these."""
        counts = []
        for rows in self.rows.T:
            order = np.argsort(rows, kind="stable")
            starts = np.flatnonzero(np.diff(rows[order], prepend=-1))
            counts.append(np.logical_or.reduceat(agree[:, order], starts, axis=1).sum(1))
        return np.minimum(*counts)

    def ransac(self, generator: np.random.Generator) -> Array:
        """Return the transform [4, 4] under which most things agree."""
        if len(self.rows) < 3:
            return np.eye(4)
        triples = generator.integers(len(self.rows), size=(constants.TRIPLES, 3))
        sides = [
            np.linalg.norm(places[triples] - places[np.roll(triples, 1, 1)], axis=2) for places in self.places
        ]
        distinct = np.minimum(*sides).min(1) > 0
        triples, sides = triples[distinct], [each[distinct] for each in sides]
        stretch = np.log(sides[0] / sides[1])
        grown = np.abs(self.growth[triples] - stretch.mean(1, keepdims=True)).max(1)
        alike = (np.ptp(stretch, 1) <= np.log(constants.RIGID)) & (grown <= np.log(constants.RESIZED))
        triples = triples[alike][: constants.TRIED]
        transforms = _similarities(self.places[1][triples], self.places[0][triples], np.ones(triples.shape))
        for _ in range(constants.FITS):
            agree = self.agree(transforms)
            agree = agree[np.argsort(-self.counts(agree), kind="stable")[: constants.BEST]]
            agree = agree[agree.sum(1) >= 3]
            if not len(agree):
                return np.eye(4)
            places = [np.broadcast_to(each, (len(agree), *each.shape)) for each in self.places]
            transforms = _similarities(places[1], places[0], agree / self.reach)
        return transforms[self.counts(self.agree(transforms)).argmax()]
