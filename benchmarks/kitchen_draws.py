"""Draws of the kitchen: regions, embeddings and labels drawn by seed, from what its Gaussians truly are.

Geometry, colours, cameras and text vectors are the
given ones, and real; the truth (``gt/``) is drawn by hand upon them. A seed draws:

* pieces: every object is cut in space into some pieces, the regions of level s;
* region maps of all 24 views: borders moved, regions missing, grown, shrunk, merged and split (``observe``). At level m
  the person is whole in half of the views, else head, clothes and hands; at level l the person, the shelves with what
  is in them, the plate with its fruit, and the table with most of what is on it are one region each;
* prototypes: real image centroids near the object's name, moved along text directions until the object has a cosine of
  .26 to .31 with its own name (.25 for the head with "person") and all others stay below; centroids of objects without
  a name, and of what has no label, at random;
* embeddings: mixtures of prototypes by what a region's pixels show, with a part's own offset at level s, surroundings,
  noise, noise of the view, and a tenth that carry a neighbour's (``observe``);
* 15 of the 28 names are asked, in 6 of the views. Their true masks are what is rendered of the truth.

The given scene follows the same recipe, but for details (its pieces and background are cut in the image).

A draw of a kind (``benchmarks.embedding_kinds``) has the embeddings and the errors of that kind instead, the same
pieces and the same labels.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

import scoup
from benchmarks.embedding_kinds import EmbeddingKind, RegionErrors, draw_hosts, draw_prototypes
from scoup import raster
from scoup.models import CANONICAL_PHRASES
from scoup.scene import LEVELS, Camera, Cameras, Gaussians, RegionMap, Regions
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.observe import (
    PART_OFFSET,
    VIEW_NOISE,
    IntMap,
    Shown,
    embed_regions,
    make_regions,
    moved_borders,
    noise,
)
from scoup_lab.synthetic.scene import frame_of_masks
from scoup_lab.synthetic.words import OWN_COSINE, unit

PERSON, CLOTHES, HAND = 4, 5, 6
GROUPS = {"person": (4, 5, 6), "shelves": (14, 15, 16), "plate": (22, 23, 24)}
TABLE = 9
ON_TABLE = (7, 8, 11, 12, 17, 18, 19, 20, 21, 30, 31, 32, 33, 34, 35)
NOT_ASKED = frozenset({"counter"})  # its label is unreliable
N_BACKGROUND = 24  # parts of what has no label
MIGHT_BE_THERE = frozenset(
    {
        "Stainless steel pots", "apple", "bag", "bookshelf", "cabinet", "coffee", "desk", "floor", "glass of water",
        "green apple", "red apple", "knife", "napkin", "paper", "paper napkin", "plastic ledge", "plastic ladle",
        "porcelain hand", "spatula", "spoon", "red cup", "otherfurniture", "otherprop", "otherstructure", "ceiling",
        "curtain", "egg", "yellow desk", "frog cup", "mirror", "stuffed bear", "lamp",
    }
)  # fmt: skip
"""Words of the table that may truly fit something in the kitchen, or whose prototypes nobody has set apart."""
PIECE = 900  # Gaussians of a piece, about; haze and dense things differ much
MOST_PIECES = 6
N_QUERIES, N_LABELLED = 15, 6
HEAD_COSINE = 0.25
MARGIN = 0.03  # how far below its own prototype all others stay for a name
NOISINESS = 1.25  # of the regions: with it, regions of one object are as alike as in the given scene


@dataclass(frozen=True, eq=False)
class Truth:
    """The true objects of the Gaussians, before anything is drawn."""

    gaussians: Gaussians
    cameras: Cameras
    ids: NDArray[np.int64]  # [N] int64 object of each Gaussian; 0 for none
    names: dict[int, str | None]  # object -> the name it is asked by, or none
    words: dict[str, Floats]  # name -> [D] unit text vector
    centroids: Floats  # [C, D] unit image embeddings of the same model

    @classmethod
    def open(cls, data: Path, scale: float) -> Truth:
        """Open the truth in the folder that contains kitchen/ and clip/."""
        kitchen = data / "kitchen"
        named = json.loads((kitchen / "gt" / "names.json").read_text())
        names = {int(number): entry["query"] for number, entry in named.items()}
        with np.load(data / "clip" / "text_vit_b16_laion2b.npz") as table:
            words = {str(name): unit(row) for name, row in zip(table["names"], table["vectors"], strict=True)}
        with np.load(data / "clip" / "image_centroids.npz") as file:
            centroids = unit(file["vectors"].astype(np.float64))
        return cls(
            scoup.load_gaussians(kitchen / "scene" / "model.splat"),
            scoup.load_cameras(kitchen).scaled(scale),
            np.load(kitchen / "gt" / "gt_labels.npy").astype(np.int64),
            names,
            words,
            centroids,
        )

    def of_name(self) -> dict[str, tuple[int, ...]]:
        """Return the objects that each name asked stands for."""
        single = {name: (number,) for number, name in self.names.items() if name and name not in NOT_ASKED}
        return single | {name: GROUPS[name] for name in ("person", "shelves")}

    def of_own_name(self) -> dict[str, tuple[int, ...]]:
        """Return ``of_name`` with the names that are not asked."""
        there = {name: (number,) for number, name in self.names.items() if name}
        return there | self.of_name()

    def absent(self, words: Iterable[str]) -> tuple[str, ...]:
        """Return the words that nothing in the scene is called, nor might be."""
        there = {name for name in self.names.values() if name} | {*GROUPS, *MIGHT_BE_THERE}
        return tuple(word for word in words if word not in there)


@dataclass(frozen=True, eq=False)
class KitchenDraw:
    """One draw."""

    regions: Regions  # of all views
    frames: list[tuple[LabelledFrame, Camera]]  # labelled ones with their cameras


@dataclass(frozen=True, eq=False)
class _Pieces:
    """Pieces of all objects, and then of the background, whose "objects" follow those with a label."""

    of_gaussian: NDArray[np.int64]  # [N] int64
    objects: NDArray[np.int64]  # [pieces] int64 object of each


@dataclass(frozen=True, eq=False)
class _Errors:
    """Errors of regions as drawn: the hosts [objects] of what is swallowed at level m, and further randomness."""

    of: RegionErrors
    hosts: NDArray[np.int64]
    rng: np.random.Generator

    def noisiness(self, labels: IntMap) -> Floats:
        """Return [R] factor of the noise of each region."""
        return NOISINESS * self.of.noise * np.exp(self.of.tail * self.rng.normal(size=int(labels.max()) + 1))


def make_draw(
    truth: Truth, seed: int, noise_scale: float = 1.0, kind: EmbeddingKind | None = None
) -> KitchenDraw:
    """Return a draw by its seed; ``noise_scale`` multiplies all noise of the embeddings. Without a kind,
    prototypes are real centroids and errors those of ``observe``."""
    for_pieces, for_words, for_regions, for_labels, for_errors = (
        np.random.default_rng([seed, purpose]) for purpose in range(5)
    )
    pieces = _cut(truth, for_pieces)
    maps = {camera.name: _piece_map(truth, pieces, camera) for camera in truth.cameras}
    count = int(pieces.objects.max()) + 1
    if kind is None:
        prototypes, errors = _prototypes(truth, count, for_words), RegionErrors()
    else:
        prototypes = draw_prototypes(kind, truth.words, truth.of_own_name(), count, for_words)
        errors = kind.errors
    errors = replace(errors, noise=noise_scale * errors.noise)
    object_maps = (pieces.objects[shown] for shown in maps.values())
    hosts = draw_hosts(object_maps, count, truth.names, errors.swallowed, for_errors)
    regions = _observed(maps, pieces, prototypes, for_regions, _Errors(errors, hosts, for_errors))

    of_name = truth.of_name()
    asked = sorted(of_name)
    chosen = sorted(asked[place] for place in for_labels.permutation(len(asked))[:N_QUERIES])
    views = sorted(for_labels.permutation(len(truth.cameras))[:N_LABELLED].tolist())
    frames = []
    for view in views:
        camera = truth.cameras[view]
        objects = pieces.objects[maps[camera.name]]
        masks = {name: torch.from_numpy(np.isin(objects, of_name[name])) for name in chosen}
        frames.append((frame_of_masks(camera.name, masks), camera))
    return KitchenDraw(regions, frames)


def _cut(truth: Truth, rng: np.random.Generator) -> _Pieces:
    """Return every object cut in space; what has no label by place and colour."""
    means = truth.gaussians.means.numpy().astype(np.float64)
    colors = truth.gaussians.sh[:, 0].numpy().astype(np.float64)
    of_gaussian = np.zeros(len(truth.ids), np.int64)
    owners: list[int] = []
    background = max(truth.names) + 1
    for number in (*sorted(truth.names), 0):
        members = np.flatnonzero(truth.ids == number)
        places = means[members]
        places = (places - np.median(places, 0)) / (np.median(np.abs(places - np.median(places, 0))) + 1e-9)
        if number == 0:
            places = np.concatenate([places, 2 * colors[members]], 1)
        count = N_BACKGROUND if number == 0 else int(np.clip(len(members) / PIECE, 1, MOST_PIECES))
        of_gaussian[members] = len(owners) + _kmeans(places.clip(-4, 4), count, rng)
        owners += [background + place if number == 0 else number for place in range(count)]
    return _Pieces(of_gaussian, np.array(owners))


def _kmeans(rows: Floats, count: int, rng: np.random.Generator, rounds: int = 12) -> NDArray[np.int64]:
    from scipy.spatial import KDTree

    centres = rows[rng.permutation(len(rows))[:count]]
    nearest = np.zeros(len(rows), np.int64)
    for _ in range(rounds):
        nearest = np.asarray(KDTree(centres).query(rows)[1], np.int64)
        sizes = np.bincount(nearest, minlength=count)
        for axis in range(rows.shape[1]):
            sums = np.bincount(nearest, rows[:, axis], count)
            centres[:, axis] = np.where(sizes > 0, sums / sizes.clip(1), centres[:, axis])
    return nearest


def _piece_map(truth: Truth, pieces: _Pieces, camera: Camera) -> IntMap:
    """Return [H, W] the piece that a view shows: of the object with the most weight (all background together),
    the piece most."""
    count = len(pieces.objects)
    indices = torch.from_numpy(pieces.of_gaussian)[:, None, None].to(torch.uint8)
    weights = torch.ones(len(indices), 1, 1)
    (image,) = raster.render_codes(raster.project(truth.gaussians, camera), indices, weights, count)
    nothing = max(truth.names) + 1
    owners = torch.from_numpy(pieces.objects.clip(max=nothing))
    of_object = image.new_zeros(*image.shape[:2], nothing + 1).index_add_(2, owners, image)
    shown = of_object.argmax(2)
    own = torch.where(owners == shown[..., None], image, -1.0)
    return own.argmax(2).int().numpy()


def _prototypes(truth: Truth, count: int, rng: np.random.Generator) -> Floats:
    """Return [count, D] unit image prototypes, by number of the object; that of 0 is not used."""
    centroids = truth.centroids
    mean = unit(centroids.mean(0))
    prototypes = centroids[rng.integers(0, len(centroids), count)]
    named = {number: name for number, name in truth.names.items() if name} | {PERSON: "person"}
    central = centroids @ mean > np.quantile(centroids @ mean, 0.2)
    for number, name in named.items():
        fit = np.where(central, centroids @ truth.words[name], -1.0)
        prototypes[number] = centroids[rng.choice(np.argsort(-fit)[:12])]
    prototypes = unit(prototypes + noise(prototypes.shape, 0.25, rng))

    names = sorted(set(named.values()))
    vectors = np.stack([truth.words[name] for name in names])
    concepts = unit(vectors - np.stack(list(truth.words.values())).mean(0))
    slopes = np.einsum("nd,nd->n", concepts, vectors)
    own = {number: HEAD_COSINE if number == PERSON else rng.uniform(*OWN_COSINE) for number in named}
    phrases = np.stack([truth.words[phrase] for phrase in CANONICAL_PHRASES])
    owner = [next(number for number, name in named.items() if name == wanted) for wanted in names]
    columns = np.arange(len(names))
    for _ in range(80):
        cosines = prototypes @ vectors.T
        # What decides is the cosine beyond that with the nearest canonical phrase.
        beyond = cosines - (prototypes @ phrases.T).max(1, keepdims=True)
        step = -(beyond - beyond[owner, columns] + MARGIN).clip(0)
        for number, name in named.items():
            step[number, names.index(name)] = own[number] - cosines[number, names.index(name)]
        step[[CLOTHES, HAND], names.index("person")] *= 0.2  # which they belong to
        prototypes = unit(prototypes + 0.5 * (step / slopes) @ concepts)
    return prototypes


def _observed(
    maps: dict[str, IntMap], pieces: _Pieces, prototypes: Floats, rng: np.random.Generator, errors: _Errors
) -> Regions:
    of_piece = prototypes[pieces.objects]
    offsets = {level: noise(of_piece.shape, PART_OFFSET if level == "s" else 0.0, rng) for level in LEVELS}
    merged = np.arange(len(prototypes))
    for group in GROUPS.values():
        merged[list(group)] = group[0]
    found: dict[str, dict[str, RegionMap]] = {}
    for name, shown in maps.items():
        moved = moved_borders(shown, rng)
        person = merged.copy() if rng.random() < 0.5 else np.arange(len(prototypes))
        at_m = np.where(
            np.isin(np.arange(len(prototypes)), GROUPS["person"]), person, np.arange(len(prototypes))
        )
        on_table = [number for number in ON_TABLE if rng.random() < 0.8]
        at_l = merged.copy()
        at_l[on_table] = TABLE
        numbers = {
            "s": moved,
            "m": at_m[errors.hosts[pieces.objects]][moved],
            "l": at_l[pieces.objects][moved],
        }
        found[name] = {}
        for level in LEVELS:
            # The view's noise belongs to an object, not to a piece of it.
            shifts = noise(prototypes.shape, errors.of.noise * VIEW_NOISE, rng)[pieces.objects]
            labels = make_regions(numbers[level].astype(np.int32), level, rng)
            seen = Shown(shown, of_piece, offsets[level], shifts)
            rows = embed_regions(labels, seen, rng, errors.noisiness(labels), errors.of.wrong)
            found[name][level] = RegionMap(
                torch.from_numpy(labels), torch.from_numpy(rows.astype(np.float32))
            )
    return Regions.from_maps(found)
