"""Ablations: the rows of ``ablation_recipes`` on scenes rasterised once, over several codebook seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import mean
from typing import Any

import numpy as np
import torch
from torch import Tensor

from scoup.base.progress import Progress, no_progress
from scoup.baselines.channels import ChannelField
from scoup.baselines.methods import MethodSettings, dense_field, voted_field
from scoup.coding import fit_codes
from scoup.coding.adam import AdamSettings, solve_adam
from scoup.coding.embeddings import normalise_embeddings
from scoup.evaluate.metrics import Interval, bootstrap_interval
from scoup.evaluate.published import ABLATIONS as PUBLISHED
from scoup.evaluate.scores import SceneScore
from scoup.evaluate.studies.ablation_recipes import BASE, Ablation, Recipe, Start
from scoup.evaluate.studies.comparison import signed
from scoup.evaluate.studies.rasterised import PreparedScene, Rule, every_nth_pixel, of_views
from scoup.evaluate.tables import CAVEATS, Table
from scoup.pictures.colors import Picture
from scoup.pictures.plots import interval_plot
from scoup.query.presence import vote_entropy
from scoup.query.presets import QueryPreset
from scoup.scene.codes import SparseCodes
from scoup.scene.regions import Regions
from scoup.uplift.rasterise import region_sums
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.vote import GaussianCodes, vote


@dataclass(frozen=True)
class AblationResult:
    """A row, over all scenes and seeds.

    Attributes:
        ablation: which.
        scores: by seed, of each scene.
    """

    ablation: Ablation
    scores: dict[int, list[SceneScore]]

    def pair_means(self) -> tuple[list[float], list[float], list[str], list[str]]:
        """IoU and hit of each pair as means over seeds (hits empty without localisation), queries and scenes."""
        runs = [[pair for scene in of_seed for pair in scene.pairs] for of_seed in self.scores.values()]
        first = next(iter(self.scores.values()))
        ious = [mean(pair.iou for pair in of_pair) for of_pair in zip(*runs, strict=True)]
        localizes = all(scene.localizes for scene in first)
        hits = (
            [mean(bool(p.hit) for p in of_pair) for of_pair in zip(*runs, strict=True)] if localizes else []
        )
        groups = [pair.label for scene in first for pair in scene.pairs]
        kinds = [scene.scene for scene in first for _ in scene.pairs]
        return ious, hits, groups, kinds

    def interval(self) -> Interval:
        """Of mIoU, each scene counting alike."""
        ious, _, groups, kinds = self.pair_means()
        return bootstrap_interval(ious, groups, scenes=kinds)

    def accuracy(self) -> float | None:
        """Of localisation."""
        _, hits, groups, kinds = self.pair_means()
        return bootstrap_interval(hits, groups, scenes=kinds).mean if hits else None

    def by_seed(self) -> list[float]:
        """mIoU of each seed."""
        return [mean(scene.miou for scene in of_seed) for of_seed in self.scores.values()]


def run_ablations(
    scenes: Sequence[PreparedScene],
    ablations: Sequence[Ablation],
    preset: QueryPreset,
    seeds: Sequence[int] = (0, 1, 2),
    epochs: int = 4000,
    progress: Progress = no_progress,
) -> list[AblationResult]:
    """Run every row on every scene with every seed; full embeddings know no seed and are run once.

    Args:
        scenes: rasterised once (and once more for each pixel stride).
        ablations: rows.
        preset: the protocol's rules.
        seeds: of the codebook.
        epochs: of Adam.
        progress: told after each recipe, seed and scene.
    """
    found: dict[str, dict[int, list[SceneScore]]] = {each.name: {} for each in ablations}
    recipes = list(dict.fromkeys(each.recipe for each in ablations))
    total = len(scenes) * len(seeds) * len(recipes)
    done = 0
    progress("ablations", 0, total)
    for scene in scenes:
        workshop = _Workshop(scene, epochs)
        for seed in seeds:
            for recipe in recipes:
                done += 1
                if recipe.coding == "dense" and seed != seeds[0]:
                    continue
                rows = [each for each in ablations if each.recipe == recipe]
                made = workshop.make(recipe, seed)
                for name, score in scene.scores(
                    made, {each.name: _rule(each, preset) for each in rows}
                ).items():
                    found[name].setdefault(seed, []).append(score)
                progress("ablations", done, total)
            workshop.forget_codes()
    return [AblationResult(each, found[each.name]) for each in ablations]


class _Workshop:
    """Makes fields of one scene by recipes; keeps what recipes share."""

    def __init__(self, scene: PreparedScene, epochs: int) -> None:
        self._scene = scene
        self._epochs = epochs
        self._codes: dict[Recipe, tuple[list[SparseCodes], Tensor]] = {}
        self._strided: dict[int, RegionSums] = {}

    def forget_codes(self) -> None:
        """Of the last seed."""
        self._codes = {}

    def make(self, recipe: Recipe, seed: int) -> ChannelField:
        regions = self._regions(recipe)
        rows = [regions.embeddings(level)[0] for level in regions.levels]
        sums = self._sums(recipe, regions)
        if recipe.coding == "dense":
            return dense_field(sums, rows, MethodSettings(seed))
        key = recipe.coded_once
        if key not in self._codes:
            self._codes[key] = _code(rows, recipe, seed, self._epochs)
        codes, codebook = self._codes[key]
        keep_between = recipe.keep or recipe.k
        found = vote(sums, codes, codebook, recipe.rounds, recipe.keep, keep_between)
        if recipe.dropped is not None:
            whole = vote(sums, codes, codebook, recipe.rounds, None, keep_between)
            found = _without(found, whole, recipe.dropped)
        return voted_field(found, codebook, recipe.keep is None)

    def _regions(self, recipe: Recipe) -> Regions:
        regions = self._scene.regions
        if recipe.views == 1:
            return regions
        names = regions.view_names
        count = max(1, round(recipe.views * len(names)))
        places = ((np.arange(count) + 0.5) * len(names) / count).astype(int)
        return of_views(regions, [names[place] for place in places])

    def _sums(self, recipe: Recipe, regions: Regions) -> RegionSums:
        scene = self._scene
        sums = scene.gathered()
        if recipe.stride > 1:
            if recipe.stride not in self._strided:
                thinned = every_nth_pixel(scene.regions, recipe.stride)
                made = region_sums(scene.gaussians, scene.cameras, thinned, scene.raster_preset)
                self._strided[recipe.stride] = made
            sums = self._strided[recipe.stride]
        rows = [regions.embeddings(level)[1] for level in regions.levels]
        return sums.of_views([name for name in sums.views if name in regions], rows)


def _code(rows: Sequence[Tensor], recipe: Recipe, seed: int, epochs: int) -> tuple[list[SparseCodes], Tensor]:
    if recipe.coding == "exact":
        books = [fit_codes(of_level, recipe.n_atoms, recipe.k, "exact", seed) for of_level in rows]
        return [book.codes for book in books], torch.stack([book.atoms for book in books])
    settings = AdamSettings(epochs, logit_scale=recipe.logit_scale)
    codes, atoms = [], []
    for of_level in rows:
        unit = normalise_embeddings(of_level)
        start = _start(unit, recipe.n_atoms, recipe.start, seed)
        solution = solve_adam(unit, recipe.n_atoms, recipe.k, seed, settings, initial_atoms=start)
        codes.append(solution.codes)
        atoms.append(solution.atoms)
    return codes, torch.stack(atoms)


def _start(rows: Tensor, n_atoms: int, start: Start, seed: int) -> Tensor | None:
    """[L, D] first atoms; None for the solver's own k-means."""
    random = torch.Generator().manual_seed(seed)
    if start == "random regions":
        return rows[torch.randint(len(rows), (n_atoms,), generator=random)]
    if start == "random directions":
        return torch.nn.functional.normalize(torch.randn(n_atoms, rows.shape[1], generator=random), dim=1)
    return None


def _without(found: GaussianCodes, whole: GaussianCodes, half: str) -> GaussianCodes:
    """Codes without those of the Gaussians in the half with the highest (or lowest) entropy of their whole votes.
    *Choice*: halves are taken at each level, among Gaussians that have votes there."""
    entropy = vote_entropy(whole.weights)
    voted = whole.weights.any(-1)
    kept = torch.zeros_like(voted)
    for level in range(voted.shape[1]):
        members = voted[:, level].nonzero()[:, 0]
        order = members[torch.argsort(entropy[members, level], stable=True)]
        middle = len(order) // 2
        kept[order[:middle] if half == "highest" else order[middle:], level] = True
    return replace(found, weights=torch.where(kept[..., None], found.weights, 0.0))


def _rule(ablation: Ablation, preset: QueryPreset) -> Rule:
    if ablation.rule == "protocol":
        return Rule(preset)
    if ablation.rule == "everyday":
        return Rule(preset, everyday=True)
    if ablation.rule in ("peak", "mask"):
        return Rule(replace(preset, level_choice=ablation.rule))
    return Rule(preset, (ablation.rule,))


def ablation_tables(results: Sequence[AblationResult], protocol: str) -> list[Table]:
    """mIoU with intervals, range over seeds, and the paired difference from the base."""
    base = next(
        result for result in results if result.ablation.recipe == BASE and result.ablation.rule == "protocol"
    )
    localizes = base.accuracy() is not None
    headers = ["change", "group", "mIoU", "95 % interval", "least to most over seeds"]
    headers += (["localisation"] if localizes else []) + [
        "minus base",
        "paper on LERF-OVS, published: mIoU / localisation",
    ]
    rows = []
    for result in results:
        interval, seeds = result.interval(), result.by_seed()
        cells = [result.ablation.name, result.ablation.group, f"{100 * interval.mean:.1f}"]
        cells.append(f"{100 * interval.low:.1f} to {100 * interval.high:.1f}")
        cells.append(f"{100 * min(seeds):.1f} to {100 * max(seeds):.1f}" if len(seeds) > 1 else "-")
        if localizes:
            cells.append(f"{100 * (result.accuracy() or 0):.1f}")
        cells.append("-" if result is base else signed(difference(result, base)))
        published = PUBLISHED.get(result.ablation.published)
        cells.append(
            "-" if published is None else " / ".join("-" if v != v else f"{v:.1f}" for v in published)
        )
        rows.append(tuple(cells))
    notes = (
        *CAVEATS,
        "Means over codebook seeds; differences are paired over queries, after that mean.",
        "The last column is the paper's, on other data: it says which way a change went there and nothing of this run.",
    )
    return [Table(f"{protocol}: ablations", tuple(headers), tuple(rows), notes)]


def difference(result: AblationResult, base: AblationResult) -> Interval:
    """mIoU of a row minus that of the base, paired over queries."""
    ious, _, groups, kinds = result.pair_means()
    others = base.pair_means()[0]
    return bootstrap_interval([a - b for a, b in zip(ious, others, strict=True)], groups, scenes=kinds)


def ablation_plot(results: Sequence[AblationResult], protocol: str) -> Picture:
    """Points with intervals, in groups."""
    rows = []
    for result in results:
        interval = result.interval()
        rows.append(
            (
                result.ablation.name,
                *(round(100 * value, 1) for value in (interval.mean, interval.low, interval.high)),
            )
        )
    headings = [result.ablation.group for result in results]
    return interval_plot(
        rows, f"Ablations, {protocol}", "mIoU, %, with 95 % intervals over queries", 900, headings
    )


def ablation_record(results: Sequence[AblationResult]) -> dict[str, Any]:
    """For JSON."""
    record = {}
    for result in results:
        interval = result.interval()
        record[result.ablation.name] = {
            "group": result.ablation.group,
            "miou": interval.mean,
            "miou_interval": [interval.low, interval.high],
            "miou_by_seed": result.by_seed(),
            "accuracy": result.accuracy(),
            "seeds": list(result.scores),
        }
    return record
