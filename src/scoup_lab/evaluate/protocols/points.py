"""Protocols whose unit is the point: the class a field gives each Gaussian, and how classes given are scored against
the true ones (``scannet``, ``scenesplat``; docs/protocols.md).

All of it counts points: a class that the truth lacks has no score, whatever was given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup.base.errors import InputError, looked_up
from scoup.query.question import TextVectors
from scoup.scene.gaussians import Gaussians
from scoup_lab.baselines.fitted import FittedMethod
from scoup_lab.data.labelled_points import LabelledPoints
from scoup_lab.evaluate.metrics import Interval
from scoup_lab.evaluate.scenes import USUAL, Places, SceneFiles, check_root, choose_scenes

NO_CLASS = -1
"""In truths: a point that does not count. In answers: a point that was given no class."""
CONFIDENCE = 0.95  # of intervals
QUERIES_AT_A_TIME = 16  # relevancy of all Gaussians to so many classes is in memory together
SPLAT = "point_cloud.ply"  # the splat of a scene if it lies in its folder, where other PLY files may lie too


@dataclass(frozen=True)
class ClassList:
    """The classes of a benchmark, in the order of their numbers."""

    name: str  # as on the command line
    classes: tuple[str, ...]  # what the truth numbers from 0
    excluded: frozenset[str] = frozenset()  # classes that foreground means leave out; queried and counted too
    prompt: str = "{}"  # the text of a class, with {} for its name
    described: tuple[tuple[str, int], ...] = ()  # in place of the prompt's: texts, and the class of each
    file: str = ""  # stem of the file that contains the truth, where the layout has several

    @property
    def texts(self) -> tuple[str, ...]:
        """Return the texts that are queried."""
        return tuple(text for text, _ in self._queried)

    def of_texts(self, positions: Tensor) -> Tensor:
        """Return numbers of classes from positions of texts (``label_gaussians``); ``NO_CLASS`` stays."""
        numbers = torch.tensor([*(number for _, number in self._queried), NO_CLASS], device=positions.device)
        return numbers[positions]  # NO_CLASS is -1, the last

    @property
    def _queried(self) -> tuple[tuple[str, int], ...]:
        return self.described or tuple(
            (self.prompt.format(name), number) for number, name in enumerate(self.classes)
        )

    @property
    def foreground(self) -> Tensor:
        """[C] boolean: the classes that are not excluded."""
        return torch.tensor([name not in self.excluded for name in self.classes])


@dataclass(frozen=True, eq=False)
class PointTruth:
    """True classes."""

    classes: Tensor  # [P] int64; ``NO_CLASS`` for points that do not count
    points: LabelledPoints | None  # take the classes of Gaussians near them; None: point i is Gaussian i

    @property
    def counts(self) -> bool:
        """Return whether any point has a class."""
        return bool((self.classes != NO_CLASS).any())

    def answers(self, gaussians: Gaussians, given: Tensor, n_classes: int, neighbours: int) -> Tensor:
        """Return [P] int64 classes of the points from those given to the Gaussians [N]."""
        if self.points is None:
            return given.cpu()
        return nearest_classes(gaussians.means, given, self.points.positions, n_classes, neighbours)


@dataclass(frozen=True)
class PointProtocol:
    """A data set whose points have classes, and its rules."""

    name: str  # as on the command line
    title: str  # in tables
    scenes: tuple[str, ...]  # of the published data set, where it names them
    class_lists: Mapping[str, ClassList]  # by name; the truth follows from the list
    default_classes: tuple[str, ...]  # names of the lists that are scored by default
    pooled: bool  # whether points of all scenes are counted together; else figures are means over scenes
    names: Callable[[Path], list[str]]  # of the scenes below ROOT
    expected: str  # what makes a scene, for errors
    folder: Callable[[Path, str], Path]  # of a scene below ROOT
    truth: Callable[[Path, ClassList, Gaussians], PointTruth]  # of the scene in a folder

    def find_class_list(self, name: str) -> ClassList:
        """Return a list of classes by name."""
        return looked_up(f"list of classes of {self.name}", name, self.class_lists)

    def find(self, root: Path, wanted: Sequence[str] = ()) -> list[str]:
        """Return the names of the scenes below ``root`` whose points have classes: those wanted, or all, the published
        ones first.
        """
        check_root(root, self.name)
        return choose_scenes(root, self.names(root), wanted, self.scenes, self.expected)

    def open(self, root: Path, name: str, places: Places = USUAL) -> PointScene:
        """Read the cameras of a scene, and find its splat and features."""
        folder = self.folder(root, name)
        if places.gaussians is None and (folder / SPLAT).is_file():
            places = replace(places, gaussians=str(folder / SPLAT))
        return PointScene(**vars(places.open(folder, name)), protocol=self)


@dataclass(frozen=True, eq=False)
class PointScene(SceneFiles):
    """A scene of a point-level data set; the truth is not read yet."""

    protocol: PointProtocol  # that scores it

    def truth(self, classes: ClassList, gaussians: Gaussians) -> PointTruth:
        """Read the true classes of the scene's points."""
        return self.protocol.truth(self.folder, classes, gaussians)


def label_gaussians(
    fitted: FittedMethod, vectors: TextVectors, texts: Sequence[str], level: int | None = None
) -> Tensor:
    """Return [N] int64 position of the text that fits each Gaussian best; ``NO_CLASS`` where nothing is known of it.

    At one level this is the argmax of the cosine, as in the protocols: relevancy grows with the cosine, and the
    canonical phrases are the same for all texts. *Choice*: of several levels, each Gaussian is answered by the one
    where a text leads the canonical phrases by most, which is its largest relevancy. Nothing is smoothed, and nothing
    is judged absent. Of equals the first text is taken.

    ``texts``: Q >= 1, one a class; ``level``: the position of the only level that answers; None for all.
    """
    coded = fitted.coded()
    if level is not None and not 0 <= level < len(coded):
        raise InputError(f"there is no level {level} among {len(coded)}")
    rows = slice(None) if level is None else slice(level, level + 1)
    coded = coded[rows]
    best = torch.full(coded.shape[1:], -torch.inf, device=coded.device)
    found = torch.full(coded.shape[1:], NO_CLASS, dtype=torch.int64, device=coded.device)
    for start in range(0, len(texts), QUERIES_AT_A_TIME):
        queries = vectors.of(texts[start : start + QUERIES_AT_A_TIME])
        relevancy = fitted.gaussian_relevancy(queries, vectors.canonical)[rows].to(coded.device)
        # A Gaussian without a code at a level has a relevancy of 0.5 there, which says nothing.
        values, positions = relevancy.masked_fill(~coded[:, None], -torch.inf).amax(0).max(0)
        better = values > best
        best = torch.where(better, values, best)
        found[better] = positions[better] + start
    return found


def nearest_classes(
    means: Tensor, classes: Tensor, positions: Tensor, n_classes: int, neighbours: int = 1
) -> Tensor:
    """Return [P] int64 class of each point, by a vote of the nearest Gaussians that have one; of equals the
    smallest number.

    ``means``: [N, 3] of the Gaussians; ``classes``: [N] of the Gaussians; those of ``NO_CLASS``, and those
    that are nowhere finite, have no vote; ``positions``: [P, 3].
    """
    from scipy.spatial import KDTree

    voters = (classes.cpu() != NO_CLASS) & torch.isfinite(means.cpu()).all(1)
    if not voters.any() or neighbours < 1:
        raise InputError(f"{int(voters.sum())} Gaussians have a class, fewer than the {neighbours} that vote")
    count = min(neighbours, int(voters.sum()))
    tree = KDTree(means.cpu()[voters].double().numpy())
    found = np.asarray(tree.query(positions.double().numpy(), k=count, workers=-1)[1]).reshape(-1, count)
    votes = classes.cpu()[voters][torch.from_numpy(found)]
    if count == 1:
        return votes[:, 0]
    counts = torch.zeros(len(votes), n_classes, dtype=torch.int32)
    return counts.scatter_add_(1, votes, torch.ones(votes.shape, dtype=torch.int32)).argmax(1)


def confusion_matrix(truth: Tensor, given: Tensor, n_classes: int) -> Tensor:
    """Return [C, C + 1] int64: how many points of each true class (row) were given each class; last column: none.

    ``truth``: [P] int64; points of ``NO_CLASS`` do not count; ``given``: [P] int64.
    """
    if truth.shape != given.shape or truth.dim() != 1:
        raise InputError(
            f"{list(truth.shape)} true classes and {list(given.shape)} given; expected one per point"
        )
    for numbers in (truth, given):
        if len(numbers) and not NO_CLASS <= int(numbers.min()) <= int(numbers.max()) < n_classes:
            raise InputError(
                f"classes are numbered {NO_CLASS} to {n_classes - 1}, not {int(numbers.min())} to "
                f"{int(numbers.max())}"
            )
    counted = truth != NO_CLASS
    columns = torch.where(given == NO_CLASS, n_classes, given)
    cells = truth[counted] * (n_classes + 1) + columns[counted]
    return torch.bincount(cells, minlength=n_classes * (n_classes + 1)).view(n_classes, n_classes + 1)


def class_totals(matrix: Tensor) -> Tensor:
    """Return [3, C] float64 of a confusion matrix [C, C + 1]: for each class the points that were found, that
    truly have it, and that were given it. Those of scenes may be added."""
    square = matrix[:, :-1].double()
    return torch.stack([square.diagonal(), matrix.double().sum(1), square.sum(0)])


def class_ious(totals: Tensor) -> Tensor:
    """Return [..., C] intersection over union of each class from totals [..., 3, C]; NaN where no point
    truly has it."""
    found, true, given = totals.unbind(-2)
    return torch.where(true > 0, found / (true + given - found), torch.nan)


def class_accuracies(totals: Tensor) -> Tensor:
    """Return [..., C] share of each class's points that were found; NaN where there are none."""
    found, true, _ = totals.unbind(-2)
    return torch.where(true > 0, found / true, torch.nan)


def class_mean(values: Tensor, counted: Tensor | None = None) -> Tensor:
    """Return [...] mean of [..., C] over the classes that have a value, and of these over those ``counted``
    ([C] boolean); NaN where there is none."""
    return (values if counted is None else values[..., counted]).nanmean(-1)


def frequency_weighted_iou(totals: Tensor) -> Tensor:
    """Return [...] mean of the classes' IoU, weighted by their shares of the points."""
    true = totals[..., 1, :]
    return (class_ious(totals).nan_to_num() * true).sum(-1) / true.sum(-1)


def overall_accuracy(totals: Tensor) -> Tensor:
    """Return [...] share of all points that were given their class."""
    return totals[..., 0, :].sum(-1) / totals[..., 1, :].sum(-1)


def drawn_totals(totals: Tensor, samples: int = 2000) -> Tensor:
    """Return [samples, 3, C] totals over T scenes drawn with replacement from totals [T, 3, C]."""
    generator = torch.Generator().manual_seed(0)
    draws = torch.randint(len(totals), (samples, len(totals)), generator=generator)
    counts = torch.zeros(samples, len(totals), dtype=totals.dtype).scatter_add_(
        1, draws, torch.ones(draws.shape, dtype=totals.dtype)
    )
    return torch.einsum("bt,tkc->bkc", counts, totals)


def interval_of(value: Tensor, drawn: Tensor) -> Interval:
    """Return a score with the interval of what draws gave it; draws without a value (NaN) do not count."""
    drawn = drawn[~drawn.isnan()]
    if not len(drawn):
        return Interval(float(value), torch.nan, torch.nan)
    ends = torch.tensor([(1 - CONFIDENCE) / 2, (1 + CONFIDENCE) / 2], dtype=drawn.dtype)
    low, high = drawn.quantile(ends).tolist()
    return Interval(float(value), low, high)
