"""Is it there at all? How sure an answer is, so that a query for something absent can return nothing.

The protocols rescale relevancy over the view before they cut it, so that something is painted whatever is asked.
Presence looks at what the rescaling throws away: how high the relevancy really is, and how far the answer stands out. A
logistic model, calibrated on labelled scenes (``scoup eval presence``), turns these signals into a probability.

Own; the method's paper and the protocols have nothing of the kind, and scores by their rules never use it.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from scoup import raster
from scoup.cameras import Camera
from scoup.errors import FileFormatError, InputError, MissingFileError
from scoup.field import LanguageField
from scoup.query import PRESETS, QueryPreset, choose_level, level_masks

SIGNALS = ("peak", "inside", "contrast")
"""What a model takes by default; see ``signals_of``. The entropy of votes was tried too and tells nothing more
(docs/evaluation.md)."""
KIND = "scoup presence model"
_RIDGE = 1e-2  # keeps the model finite where the signals part the classes


@dataclass(frozen=True)
class PresenceModel:
    """A logistic model of presence in a view.

    Attributes:
        signals: names of what it takes, in order.
        center, scale: of each signal over the calibration set; signals are put into these units first.
        weights: of each signal.
        bias: added to their sum.
        threshold: a query is present in a view from this probability on.
        scene_threshold: a query is present in a scene from this probability on, at its largest over all views.
        calibrated_on: what the model was fitted to, for people.
    """

    signals: tuple[str, ...]
    center: tuple[float, ...]
    scale: tuple[float, ...]
    weights: tuple[float, ...]
    bias: float
    threshold: float = 0.5
    scene_threshold: float = 0.5
    calibrated_on: str = ""

    def probability(self, signals: Tensor) -> Tensor:
        """[...] float64 of signals [..., F] in the order of ``signals``."""
        units = (signals.double() - torch.tensor(self.center).double()) / torch.tensor(self.scale).double()
        return torch.sigmoid(units @ torch.tensor(self.weights).double() + self.bias)


def fit_presence(
    signals: Tensor, present: Tensor, names: Sequence[str] = SIGNALS, calibrated_on: str = ""
) -> PresenceModel:
    """Fit the model by Newton's method; both classes count alike, however many answers each has.

    Args:
        signals: [M, F] finite.
        present: [M] boolean.
        names: of the F signals.
        calibrated_on: kept in the model.

    Raises:
        InputError: shapes do not fit, or a class is empty.
    """
    rows, truth = signals.double().numpy(), present.bool().numpy()
    if rows.ndim != 2 or rows.shape != (len(truth), len(names)):
        raise InputError(
            f"signals {list(signals.shape)} do not fit {len(truth)} answers and {len(names)} names"
        )
    if truth.all() or not truth.any():
        raise InputError("to calibrate presence one needs answers of both kinds, present and absent")
    center, scale = rows.mean(0), np.maximum(rows.std(0), 1e-9)
    design = np.column_stack([(rows - center) / scale, np.ones(len(rows))])
    importance = np.where(truth, 0.5 / truth.sum(), 0.5 / (~truth).sum()) * len(truth)
    ridge = _RIDGE * len(truth) * np.diag([1.0] * len(names) + [0.0])
    weights = np.zeros(design.shape[1])
    for _ in range(50):
        chance = 1 / (1 + np.exp(-(design @ weights).clip(-30, 30)))
        gradient = design.T @ (importance * (truth - chance)) - ridge @ weights
        curvature = (design * (importance * chance * (1 - chance))[:, None]).T @ design + ridge
        step = np.linalg.solve(curvature + 1e-9 * np.eye(len(weights)), gradient)
        weights += step
        if np.abs(step).max() < 1e-8:
            break
    return PresenceModel(
        tuple(names),
        tuple(center.tolist()),
        tuple(scale.tolist()),
        tuple(weights[:-1].tolist()),
        float(weights[-1]),
        calibrated_on=calibrated_on,
    )


def vote_entropy(weights: Tensor) -> Tensor:
    """[N, S] float32 entropy of votes, 0 (all views agree) to 1; 1 for a Gaussian without a code.

    Args:
        weights: [N, S, K] not negative: code weights as stored, or accumulators.
    """
    weights = weights.float()
    total = weights.sum(-1, keepdim=True)
    share = torch.where(total > 0, weights / total.clamp(min=1e-30), 0.0)
    found = torch.special.entr(share).sum(-1) / np.log(max(2, weights.shape[-1]))
    return torch.where(total[..., 0] > 0, found, 1.0)


def rendered_mean(view: raster.View, values: Tensor, coded: Tensor) -> Tensor:
    """[S, H, W] mean of values [N, S] over the coded Gaussians [N, S] that paint each pixel; 1 where none does."""
    counted = coded.float()
    image, _ = raster.render_channels(view, torch.cat([values.float() * counted, counted], 1))
    summed, weight = image.permute(2, 0, 1).chunk(2)
    return torch.where(weight > 1e-6, summed / weight.clamp(min=1e-6), 1.0)


def signals_of(
    relevancy: Tensor, extra: Sequence[Tensor] = (), preset: QueryPreset = PRESETS["default"]
) -> Tensor:
    """[3 + E] float64 signals of one answer in one view.

    They are: the largest smoothed relevancy at the level that answers ("peak"); its mean inside the mask ("inside");
    how far that lies above the mean outside ("contrast"); then the mean of each extra map inside the mask. An empty
    mask has 0.5, 0 and, of each extra map, the mean over the view.

    Args:
        relevancy: [S, H, W] of one query.
        extra: maps [S, H, W], such as the entropy of the votes (``rendered_mean``).
        preset: what the answer is by.
    """
    smoothed, masks = level_masks(relevancy, preset)
    level = choose_level(smoothed, masks, preset.level_choice)
    shown, mask = smoothed[level].double(), masks[level]
    inside = float(shown[mask].mean()) if mask.any() else 0.5
    outside = float(shown[~mask].mean()) if not mask.all() else inside
    contrast = inside - outside if mask.any() else 0.0
    more = [float((each[level][mask] if mask.any() else each[level]).double().mean()) for each in extra]
    return torch.tensor([float(shown.max()), inside, contrast, *more], dtype=torch.float64)


def view_presence(relevancy: Tensor, model: PresenceModel, preset: QueryPreset = PRESETS["default"]) -> float:
    """Probability that a query is present in a view.

    Args:
        relevancy: [S, H, W] of the query in that view.
        model: calibrated on ``SIGNALS``.
        preset: by which the answer is made.

    Raises:
        InputError: the model takes other signals.
    """
    if model.signals != SIGNALS:
        raise InputError(
            f"the presence model takes {', '.join(model.signals)}; here are {', '.join(SIGNALS)}"
        )
    return float(model.probability(signals_of(relevancy.cpu(), preset=preset)))


def scene_presence(
    field: LanguageField,
    cameras: Iterable[Camera],
    queries: Tensor,
    canonical: Tensor,
    model: PresenceModel,
    preset: QueryPreset = PRESETS["default"],
) -> Tensor:
    """[Q] float64: the largest probability over views of each query; all views are rendered.

    Args:
        field: asked.
        cameras: views of it, at least one.
        queries, canonical: [Q, D] and [P, D] unit vectors.
        model, preset: as for ``view_presence``.

    Raises:
        InputError: there are no views, or the model takes other signals.
    """
    found = torch.zeros(0, len(queries), dtype=torch.float64)
    for camera in cameras:
        maps = field.relevancy(camera, queries, canonical)
        row = [view_presence(of_query, model, preset) for of_query in maps.unbind(1)]
        found = torch.cat([found, torch.tensor([row], dtype=torch.float64)])
    if not len(found):
        raise InputError("presence in a scene is judged in views; there are none")
    return found.amax(0)


def save_presence(model: PresenceModel, path: str | Path, overwrite: bool = False) -> None:
    """Write a model as JSON.

    Raises:
        OutputExistsError: the file is there and ``overwrite`` is false.
    """
    from scoup.io import write_text

    write_text(path, json.dumps({"kind": KIND, "version": 1, **asdict(model)}, indent=1) + "\n", overwrite)


def load_presence(path: str | Path) -> PresenceModel:
    """Read a model.

    Raises:
        MissingFileError: there is no such file.
        FileFormatError: it is no presence model, or damaged.
    """
    from scoup.io.reading import read_json

    path = Path(path)
    remedy = "make one with scoup eval presence"
    if not path.is_file():
        raise MissingFileError(path, "there is no such file (a presence model was expected)", remedy)
    content = read_json(path, "a presence model")
    if not isinstance(content, dict) or content.get("kind") != KIND or content.get("version") != 1:
        raise FileFormatError(path, "is no presence model of version 1", remedy)
    try:
        names = tuple(str(name) for name in content["signals"])
        center, scale, weights = (
            tuple(float(value) for value in content[key]) for key in ("center", "scale", "weights")
        )
        bias, threshold, scene_threshold = (
            float(content[key]) for key in ("bias", "threshold", "scene_threshold")
        )
    except (KeyError, TypeError, ValueError) as error:
        raise FileFormatError(path, f"is damaged ({error})", remedy) from error
    numbers = [*center, *scale, *weights, bias, threshold, scene_threshold]
    lengths = {len(names), len(center), len(scale), len(weights)}
    if len(lengths) > 1 or not np.isfinite(numbers).all() or min(scale, default=0) <= 0:
        raise FileFormatError(path, "holds numbers that make no model", remedy)
    told = str(content.get("calibrated_on", ""))
    return PresenceModel(names, center, scale, weights, bias, threshold, scene_threshold, told)
