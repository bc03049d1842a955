"""What one asks a language field: where is it, which pixels are it, which Gaussians are it
(docs/protocols.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, get_args

import torch
from torch import Tensor

from scoup.base.errors import InputError, UnknownNameError
from scoup.query.smoothing import Border, box_mean, mask_sums, rescale, smoothed_masks

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.query.neighbours import Neighbourhood

LevelChoice = Literal["peak", "mask"]


@dataclass(frozen=True)
class QueryPreset:
    """How relevancy maps become answers.

    Attributes:
        name: of the system it follows.
        kernel: side of the box that averages the relevancy, in pixels.
        border: "inside" averages over the pixels of the box inside the image; "reflect" mirrors the image at
            its edge pixels (which are not repeated).
        threshold: a pixel belongs to the mask if its rescaled relevancy is above this.
        smoothing: side of the box that smooths the mask by majority; 1 leaves it alone.
        level_choice: whose mask answers. "peak": the level with the largest smoothed relevancy, as in the papers'
            protocol for LERF-OVS; "mask": the level whose own mask has the largest mean of smoothed relevancy.
    """

    name: str
    kernel: int
    border: Border
    threshold: float
    smoothing: int
    level_choice: LevelChoice = "peak"

    def __post_init__(self) -> None:
        if self.kernel < 1 or self.smoothing < 1:
            raise InputError(f"box sides must be at least 1 pixel, got {self.kernel} and {self.smoothing}")
        if not 0 <= self.threshold <= 1:
            raise InputError(f"the threshold must be 0 to 1, got {self.threshold}")
        if self.level_choice not in get_args(LevelChoice):
            raise InputError(f"the level is chosen by 'peak' or 'mask', not by {self.level_choice!r}")


QUERY_PRESETS: dict[str, QueryPreset] = {
    "default": QueryPreset(
        "default", kernel=7, border="inside", threshold=0.6, smoothing=7, level_choice="mask"
    ),
    "scoup": QueryPreset("scoup", kernel=7, border="inside", threshold=0.6, smoothing=7),
    "langsplatv2": QueryPreset("langsplatv2", kernel=29, border="inside", threshold=0.4, smoothing=7),
    "langsplat": QueryPreset("langsplat", kernel=30, border="reflect", threshold=0.4, smoothing=1),
}
"""Presets by name: "default" for everyday use, the others as the systems of their names answer LERF-OVS."""

DATASET_THRESHOLDS: dict[str, dict[str, float]] = {
    "lerf-ovs": {"default": 0.6, "scoup": 0.6, "langsplatv2": 0.4, "langsplat": 0.4},
    "3d-ovs": {"default": 0.3, "scoup": 0.3, "langsplatv2": 0.25},
    "mipnerf360": {"default": 0.45, "scoup": 0.45, "langsplatv2": 0.4},
}
"""Thresholds as the papers tuned them per data set. Only the thresholds: ``scoup.evaluate`` has one file a data set
with the rest of its rules."""


def query_preset(name: str, dataset: str = "lerf-ovs", threshold: float | None = None) -> QueryPreset:
    """A preset by name, with the threshold of a data set or one of your own.

    Raises:
        UnknownNameError: there is no such preset, or it has no threshold for that data set.
    """
    if name not in QUERY_PRESETS:
        raise UnknownNameError("query preset", name, QUERY_PRESETS)
    if threshold is None:
        if dataset not in DATASET_THRESHOLDS:
            raise UnknownNameError("data set with thresholds", dataset, DATASET_THRESHOLDS)
        if name not in DATASET_THRESHOLDS[dataset]:
            raise UnknownNameError(f"query preset for {dataset}", name, DATASET_THRESHOLDS[dataset])
        threshold = DATASET_THRESHOLDS[dataset][name]
    return replace(QUERY_PRESETS[name], threshold=threshold)


@dataclass(frozen=True, eq=False)
class Localization:
    """Where a query is.

    Attributes:
        pixels: [M, 2] int64 (x, y), all pixels of maximal averaged relevancy, M >= 1, row by row.
        pixel: (x, y), the one of them nearest to their mean.
        level: position of the level chosen.
        score: the maximum, 0..1.
    """

    pixels: Tensor  # [M, 2]
    pixel: tuple[int, int]
    level: int
    score: float


@dataclass(frozen=True, eq=False)
class Segmentation:
    """Which pixels a query is.

    Attributes:
        mask: [H, W] boolean.
        level: position of the level chosen.
        score: the largest smoothed relevancy at that level, 0..1.
        coverage: share of the image in the mask, 0..1.
        box: (x0, y0, x1, y1) around the mask in pixels, x1 and y1 one past the last; None if it is empty.
    """

    mask: Tensor  # [H, W]
    level: int
    score: float
    coverage: float
    box: tuple[int, int, int, int] | None


def localize(
    relevancy: Tensor, preset: QueryPreset = QUERY_PRESETS["default"], averaged: Tensor | None = None
) -> Localization:
    """The most relevant place in one view (protocols.md, LERF-OVS, "Localisation").

    Each level is averaged by the preset's box; the level with the largest maximum is chosen, the first of
    equals, whatever the preset's ``level_choice``.

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: its box is used.
        averaged: see ``averaged_by``, if at hand.
    """
    averaged = averaged_by(relevancy, preset) if averaged is None else averaged
    peaks = averaged.flatten(1).amax(1)
    level = int(peaks.argmax())
    pixels = (averaged[level] == peaks[level]).nonzero().flip(1)
    # Of a plateau, a pixel in its middle says more than its first corner.
    offsets = pixels.double() - pixels.double().mean(0)
    x, y = pixels[int(offsets.square().sum(1).argmin())].tolist()
    return Localization(pixels, (x, y), level, float(peaks[level]))


def segment(
    relevancy: Tensor, preset: QueryPreset = QUERY_PRESETS["default"], averaged: Tensor | None = None
) -> Segmentation:
    """The pixels of one view that answer a query (protocols.md, LERF-OVS, steps 1 to 4).

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: box, threshold, mask smoothing and choice of the level.
        averaged: see ``averaged_by``, if at hand.
    """
    smoothed, masks = level_masks(relevancy, preset, averaged)
    peaks, areas, sums = mask_sums(smoothed, masks)
    level = _chosen_level(peaks, areas, sums, preset.level_choice)
    mask = masks[level]
    coverage = int(areas[level]) / mask.numel()
    return Segmentation(mask, level, float(peaks[level]), coverage, mask_box(mask))


def localize_and_segment(
    relevancy: Tensor, preset: QueryPreset = QUERY_PRESETS["default"]
) -> tuple[Localization, Segmentation]:
    """Both answers of one view, the box means worked out once.

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: how relevancy becomes answers.
    """
    averaged = averaged_by(relevancy, preset)
    return localize(relevancy, preset, averaged), segment(relevancy, preset, averaged)


def averaged_by(relevancy: Tensor, preset: QueryPreset) -> Tensor:
    """[S, H, W] box means of relevancy [S, H, W] by a preset's box: what ``localize`` and ``segment`` both need.

    Raises:
        InputError: relevancy has another shape, or is empty.
    """
    return box_mean(_checked(relevancy), preset.kernel, preset.border)


def level_masks(
    relevancy: Tensor, preset: QueryPreset, averaged: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """What every level would answer (protocols.md, LERF-OVS, steps 1 to 3).

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: box, threshold and mask smoothing.
        averaged: see ``averaged_by``, if at hand.

    Returns:
        smoothed relevancy [S, H, W], dtype of ``relevancy``, and masks [S, H, W] boolean.
    """
    averaged = averaged_by(relevancy, preset) if averaged is None else averaged
    return smoothed_masks(relevancy, averaged, preset.threshold, preset.smoothing)


def choose_level(smoothed: Tensor, masks: Tensor, choice: LevelChoice) -> int:
    """Position of the level that answers (protocols.md, LERF-OVS, step 4); the first of equals.

    With "mask", a level with an empty mask is never chosen, unless all are empty: then the peak decides.

    Args:
        smoothed, masks: [S, H, W] each, from ``level_masks``.
        choice: see ``QueryPreset``.
    """
    return _chosen_level(*mask_sums(smoothed, masks), choice)


def _chosen_level(peaks: Tensor, areas: Tensor, sums: Tensor, choice: LevelChoice) -> int:
    """``choose_level`` by what ``mask_sums`` gives."""
    if choice == "peak" or not areas.any():
        return int(peaks.argmax())
    return int(torch.where(areas > 0, sums / areas, -torch.inf).argmax())


def mask_box(mask: Tensor) -> tuple[int, int, int, int] | None:
    """(x0, y0, x1, y1) around the true pixels of [H, W], x1 and y1 one past the last; None if there are
    none.
    """
    if not mask.numel():
        return None
    bits = mask.view(torch.uint8)  # of which torch finds the largest much sooner than any of a boolean
    rows, columns = bits.amax(1).nonzero()[:, 0], bits.amax(0).nonzero()[:, 0]
    if not len(rows):
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def _checked(relevancy: Tensor) -> Tensor:
    if relevancy.dim() != 3 or 0 in relevancy.shape:
        raise InputError(
            f"relevancy of one query must be [S, H, W] and not empty, got {list(relevancy.shape)}"
        )
    return relevancy


def select(
    field: LanguageField,
    queries: Tensor,  # [D] or [Q, D]
    canonical: Tensor,  # [P, D]
    threshold: float = 0.6,
    neighbours: int | None = None,
    rescaled: bool = True,
) -> Tensor:
    """The Gaussians that answer a query by their own codes, without rendering (protocols.md, "3D-selection").

    Per query the level with the largest relevancy is taken, after smoothing if asked for. Gaussians without a
    code at that level are never selected.

    Args:
        field: the language field; its geometry is needed only for ``neighbours``.
        queries: [D] or [Q, D] unit-norm text embeddings.
        canonical: [P, D] unit-norm embeddings of the canonical phrases.
        threshold: a Gaussian is selected above this.
        neighbours: blend each Gaussian's relevancy half and half with the mean of so many nearest coded
            neighbours (10 in VALA-3D); None: do not.
        rescaled: stretch the relevancy of the level as ``rescale`` does before it meets the threshold, as in
            VALA-3D; otherwise the threshold is on the relevancy itself, and nothing may pass it.

    Returns:
        Boolean [N], or [Q, N] for [Q, D].

    Raises:
        InputError: shapes do not fit, or ``neighbours`` is below 1.
    """
    found = list(
        select_with_level(
            field,
            queries if queries.dim() == 2 else queries[None],
            canonical,
            threshold,
            neighbours,
            rescaled,
        )
    )
    if queries.dim() == 1:
        return found[0][0]
    masks = [chosen for chosen, _, _ in found]
    return torch.stack(masks) if masks else field.code_weights.new_zeros(0, len(field.code_weights)).bool()


def select_with_level(
    field: LanguageField,
    queries: Tensor,  # [Q, D]
    canonical: Tensor,  # [P, D]
    threshold: float = 0.6,
    neighbours: int | None = None,
    rescaled: bool = True,
) -> Iterator[tuple[Tensor, Tensor, int]]:
    """``select`` query by query, with what it was decided by.

    Returns:
        For each query the Gaussians selected [N] boolean, their relevancy [N] at the level taken, smoothed if asked
        for, and that level's position.
    """
    from scoup.query.neighbours import Neighbourhood

    if neighbours is not None and neighbours < 1:
        raise InputError(f"neighbours must be at least 1, got {neighbours}")
    coded = (field.code_weights > 0).any(-1).T  # [S, N]
    around = Neighbourhood.of(field.gaussians.means, coded.any(0), neighbours) if neighbours else None
    for query in queries:
        relevancy = field.gaussian_relevancy(query[None], canonical)[:, 0]
        values = relevancy if around is None else around.blend(relevancy, coded)
        chosen, level = _select_level(values, coded, threshold, rescaled)
        yield chosen, values[level], level


def select_by_relevancy(
    relevancy: Tensor,  # [S, N]
    coded: Tensor,  # [S, N]
    around: Neighbourhood | None = None,
    threshold: float = 0.6,
    rescaled: bool = True,
) -> Tensor:
    """``select`` for one query whose relevancy is at hand, whatever it comes from.

    Args:
        relevancy: [S, N] of every Gaussian at every level.
        coded: [S, N] boolean, those that may be selected.
        around: neighbours to blend with.
        threshold, rescaled: see ``select``.

    Returns:
        [N] boolean.
    """
    values = relevancy if around is None else around.blend(relevancy, coded)
    return _select_level(values, coded, threshold, rescaled)[0]


def _select_level(values: Tensor, coded: Tensor, threshold: float, rescaled: bool) -> tuple[Tensor, int]:
    """Of relevancy [S, N]: the Gaussians [N] selected at the level of the largest, and its position."""
    masked = torch.where(coded, values, -torch.inf)
    peaks = masked.amax(1) if masked.shape[1] else masked.new_full((len(masked),), -torch.inf)
    level = int(peaks.argmax())
    chosen = torch.zeros_like(coded[level])
    members = coded[level]
    if members.any():
        candidates = values[level, members]
        chosen[members] = (rescale(candidates) if rescaled else candidates) > threshold
    return chosen, level
