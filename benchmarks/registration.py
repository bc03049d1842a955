"""Captures of one place in frames of their own, and of different places: registration against the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import scoup
from benchmarks.compare import KINDS, changed_scene, drawn_changes, false_changes, scored
from benchmarks.data import data_folder
from benchmarks.real_scenes import FOLDERS, RealScene
from benchmarks.scenes import LAYOUTS, field_of, find_layout
from benchmarks.study import Record, Study
from scoup.base import InputError
from scoup.query import compare
from scoup.query.comparison import Comparison
from scoup.query.registration import moved_points
from scoup.scene import Cameras, Gaussians, RegionMap, Regions, quats_of_rotations, rotation_matrices
from scoup_lab.bench import markdown
from scoup_lab.synthetic.words import unit

Array = NDArray[np.floating[Any]]
SCALES = (0.3, 3.0)
SHIFT = 3.0  # scene units, standard deviation along each axis
LIGHT = 0.3  # length of what another light adds to all embeddings of a capture
KEPT = 0.5  # share of a splat's Gaussians in a copy
NOISE = 0.3  # of their positions, in largest standard deviations
RIGHT = 0.01  # of the diagonal of a capture: the median error up to which a transform is found
INNER = (0.1, 0.9)  # shares of the Gaussians along each axis between which the error is taken
SIMULATED, REAL = "simulated, up to a third changed", "real models, halves of the path"
FOUND, KNOWN = "transform found", "transform passed"
Pair = tuple[scoup.LanguageField, scoup.LanguageField]


@dataclass(frozen=True, kw_only=True)
class Registration(Study):
    """Register pairs of captures of one place in different frames, and of different places.

    Simulated pairs, of a layout with a seed: up to a third of the things removed, added or moved, other cameras, splat,
    masks and embeddings, and all embeddings of the later capture shifted, as another light may. Scenes with real
    models: both halves of the path of cameras, each over a noisy copy of the splat with half of its Gaussians; nothing
    changed. The later capture is turned by 0 to 180 degrees, scaled by 0.3 to 3, and shifted. Different places: all old
    with all new captures of the first simulated pairs, and of the real ones. The constants of
    scoup.query.registration were tuned on seeds 100 and 101, and on every other view of the scenes with real models.
    """

    scenes: tuple[str, ...] = tuple(f"{layout}-{seed}" for seed in range(5) for layout in LAYOUTS)
    """Layouts of benchmarks.scenes with a seed."""
    n_gaussians: int = 20_000
    """Of a simulated capture."""
    real: tuple[str, ...] = tuple(FOLDERS)
    """Scenes with real models."""
    data: Path = field(default_factory=data_folder)
    """Folder of the scenes with real models."""

    rows_depend_on = ("n_gaussians",)

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        sorts: dict[str, tuple[Sequence[str], Callable[[str], tuple[Pair, Record]]]] = {
            SIMULATED: (self.scenes, lambda name: turned_layout(name, self.n_gaussians)),
            REAL: (self.real, lambda name: noisy_halves(name, self.data)),
        }
        for sort, (names, measured) in sorts.items():
            places: dict[str, Pair] = {}
            different = f"different places, {sort}"
            for number, name in enumerate(names):
                compared = different not in known and (sort == REAL or number < len(LAYOUTS))
                if name not in known or compared:
                    pair, figures = measured(name)
                    if compared:
                        places[name] = pair
                    yield name, figures
            if different not in known:
                yield different, accepted(places)

    def line(self, figures: Any) -> str:
        return str({name: figures.get(name) for name in ("agreeing", "things", "error", "places", "pairs")})

    @staticmethod
    def table(record: Record) -> str:
        """Return how often a transform was found, and the changes with it and with the true one."""
        rows, simulated = record["rows"], record["settings"]["scenes"]
        sorts = {
            SIMULATED: [rows[name] for name in simulated],
            REAL: [rows[name] for name in record["settings"]["real"]],
        }
        body = []
        for sort, records in sorts.items():
            found = [each for each in records if each.get("error", np.inf) <= RIGHT]
            refused = sum("error" not in each for each in records)
            reported = [_reported(sort, records, way) for way in (FOUND, KNOWN)]
            counts = [str(count) for count in (len(found), refused, len(records) - len(found) - refused)]
            body.append([f"{sort} ({len(records)})", *counts, *reported])
        for sort in sorts:
            of = rows[f"different places, {sort}"]
            wrong = len(of["accepted"])
            name = f"different places, {sort.partition(',')[0]} ({of['pairs']})"
            body.append([name, "", str(of["pairs"] - wrong), str(wrong), "", ""])
        headers = ["pairs of captures", "found", "refused", "wrong", f"right changes, {FOUND}", KNOWN]
        return markdown(headers, body)


def _reported(sort: str, records: Sequence[Record], way: str) -> str:
    """Return the right ones of the changes reported, and of the true ones."""
    of = [each[way][kind] for each in records if way in each for kind in KINDS]
    right, reported, true = (sum(each[place] for each in of) for place in range(3))
    return f"{right} of {reported}" + (f"; {right} of {true} true" if sort == SIMULATED else "")


@dataclass(frozen=True, eq=False)
class Frame:
    """x -> scale * (turn @ x + shift)."""

    turn: Array  # [3, 3]
    shift: Array  # [3]
    scale: float

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Frame:
        """Draw a turn of 0 to 180 degrees about any axis, a scale and a shift."""
        axis = unit(rng.normal(size=3))
        turn = Rotation.from_rotvec(axis * rng.uniform(0, np.pi)).as_matrix()
        return cls(turn, rng.normal(size=3) * SHIFT, float(np.exp(rng.uniform(*np.log(SCALES)))))

    @property
    def back(self) -> Array:
        """[4, 4] from this frame to the one before."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.scale * self.turn, self.scale * self.shift
        return np.linalg.inv(matrix)

    @property
    def degrees(self) -> float:
        """Return the angle of the turn."""
        return float(np.degrees(Rotation.from_matrix(self.turn).magnitude()))

    def moved(self, gaussians: Gaussians, cameras: Cameras) -> tuple[Gaussians, Cameras]:
        """Return Gaussians without higher harmonics, and cameras, in this frame."""
        turn = torch.from_numpy(self.turn)
        moved = replace(
            gaussians,
            means=(self.scale * (gaussians.means.double() @ turn.T + torch.from_numpy(self.shift))).float(),
            quats=quats_of_rotations(turn @ rotation_matrices(gaussians.quats.double())).float(),
            scales=gaussians.scales * self.scale,
            source_rows=None,
        )
        return moved, Cameras([camera.moved(self.turn, self.shift, self.scale) for camera in cameras])


def in_other_light(regions: Regions, rng: np.random.Generator) -> Regions:
    """Return regions whose embeddings are all moved in one direction."""
    shift: torch.Tensor | None = None
    maps: dict[str, dict[str, RegionMap]] = {}
    for view in regions.view_names:
        for level in regions.levels:
            of_view = regions.load(view, level)
            if shift is None:
                shift = LIGHT * torch.from_numpy(unit(rng.normal(size=of_view.embeddings.shape[1]))).float()
            shifted = torch.nn.functional.normalize(of_view.embeddings + shift, dim=1)
            maps.setdefault(view, {})[level] = replace(of_view, embeddings=shifted)
    return Regions.from_maps(maps)


def registered(
    pair: Pair, words: Sequence[str], frame: Frame, figures: Callable[[Comparison], Record]
) -> Record:
    """Return the error of the transform found, and figures of the changes with it and with the true one."""
    old, new = pair
    record: Record = {"degrees": round(frame.degrees, 1), "scale": round(frame.scale, 3)}
    record[KNOWN] = figures(compare(old, new, words, frame.back))
    try:
        found = compare(old, new, words)
    except InputError:
        return record
    means = old.gaussians.means.double().numpy()
    low, high = np.quantile(means, INNER, axis=0)
    inside = means[((means >= low) & (means <= high)).all(1)]
    again = moved_points(moved_points(inside, np.linalg.inv(frame.back)), found.registration.transform)
    error = float(np.median(np.linalg.norm(again - inside, axis=1)) / np.linalg.norm(high - low))
    counts = {name: getattr(found.registration, name) for name in ("source", "agreeing", "things")}
    return record | counts | {"error": float(f"{error:.2g}"), FOUND: figures(found)}


def turned_layout(name: str, n_gaussians: int) -> tuple[Pair, Record]:
    """Return the captures of a layout with a seed, and their record."""
    kind, _, seed = name.rpartition("-")
    layout, rng = find_layout(kind), np.random.default_rng([int(seed), 73])
    things = layout.things()
    before, after, truth = drawn_changes(things, rng, round(len(things) / 9))
    first = changed_scene(layout, int(seed), n_gaussians, before, 0)
    then = changed_scene(layout, int(seed), n_gaussians, after, 1000)
    frame = Frame.drawn(rng)
    gaussians, cameras = frame.moved(then.gaussians, then.building)
    then = replace(then, gaussians=gaussians, building=cameras, regions=in_other_light(then.regions, rng))
    pair = field_of(first), field_of(then)
    words = first.words.texts
    return pair, registered(pair, words, frame, lambda found: scored(found, first, then, truth, False))


def noisy_halves(name: str, data: Path) -> tuple[Pair, Record]:
    """Return fields of both halves of the views, over noisy copies of the splat, the second in another frame, and their
    record."""
    scene, rng = RealScene.open(name, data), np.random.default_rng([*name.encode()])
    frame, built, half = Frame.drawn(rng), [], len(scene.cameras) // 2
    for number, views in enumerate((scene.cameras[:half], scene.cameras[half:])):
        gaussians = scene.gaussians()
        gaussians = gaussians.select(torch.from_numpy(rng.random(len(gaussians)) < KEPT))
        largest = gaussians.scales.amax(1, keepdim=True)
        noise = NOISE * torch.from_numpy(rng.normal(size=(len(gaussians), 3))).float()
        means = gaussians.means + noise * largest.clamp(max=3 * float(largest.median()))
        gaussians, cameras = replace(gaussians, means=means, source_rows=None), Cameras(views)
        if number:
            gaussians, cameras = frame.moved(gaussians, cameras)
        sources = scoup.FieldSources(scene.encoder.name)
        built.append(
            scoup.build(gaussians, cameras, scene.regions, sources=sources).with_encoder(scene.encoder)
        )
    pair = built[0], built[1]
    return pair, registered(pair, list(scene.encoder.names or ()), frame, false_changes)


def accepted(captures: Mapping[str, Pair]) -> Record:
    """Return the pairs of different places that are compared, of all old with all new captures."""
    wrong = []
    for one, other in permutations(captures, 2):
        old, new = captures[one][0], captures[other][1]
        try:
            compare(old, new, list(old.encoder.names or ()))
        except InputError:
            continue
        wrong.append([one, other])
    return {"pairs": len(captures) * (len(captures) - 1), "accepted": wrong}
