"""What one asks a language field: where is it, which pixels are it, which Gaussians are it
(docs/protocols.md).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, get_args

import torch
from torch import Tensor

from scoup.errors import InputError, UnknownNameError

if TYPE_CHECKING:
    from scoup.field import LanguageField
    from scoup.neighbours import Neighbourhood

Border = Literal["inside", "reflect"]
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


PRESETS: dict[str, QueryPreset] = {
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
    if name not in PRESETS:
        raise UnknownNameError("query preset", name, PRESETS)
    if threshold is None:
        if dataset not in DATASET_THRESHOLDS:
            raise UnknownNameError("data set with thresholds", dataset, DATASET_THRESHOLDS)
        if name not in DATASET_THRESHOLDS[dataset]:
            raise UnknownNameError(f"query preset for {dataset}", name, DATASET_THRESHOLDS[dataset])
        threshold = DATASET_THRESHOLDS[dataset][name]
    return replace(PRESETS[name], threshold=threshold)


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


def localize(relevancy: Tensor, preset: QueryPreset = PRESETS["default"]) -> Localization:
    """The most relevant place in one view (protocols.md, LERF-OVS, "Localisation").

    Each level is averaged by the preset's box; the level with the largest maximum is chosen, the first of
    equals, whatever the preset's ``level_choice``.

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: its box is used.
    """
    averaged = box_mean(_checked(relevancy), preset.kernel, preset.border)
    peaks = averaged.flatten(1).amax(1)
    level = int(peaks.argmax())
    pixels = (averaged[level] == peaks[level]).nonzero().flip(1)
    # Of a plateau, a pixel in its middle says more than its first corner.
    offsets = pixels.double() - pixels.double().mean(0)
    x, y = pixels[int(offsets.square().sum(1).argmin())].tolist()
    return Localization(pixels, (x, y), level, float(peaks[level]))


def segment(relevancy: Tensor, preset: QueryPreset = PRESETS["default"]) -> Segmentation:
    """The pixels of one view that answer a query (protocols.md, LERF-OVS, steps 1 to 4).

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: box, threshold, mask smoothing and choice of the level.
    """
    smoothed, masks = level_masks(relevancy, preset)
    level = choose_level(smoothed, masks, preset.level_choice)
    mask = masks[level]
    return Segmentation(mask, level, float(smoothed[level].max()), float(mask.float().mean()), mask_box(mask))


def level_masks(relevancy: Tensor, preset: QueryPreset) -> tuple[Tensor, Tensor]:
    """What every level would answer (protocols.md, LERF-OVS, steps 1 to 3).

    Args:
        relevancy: [S, H, W] of one query, 0..1.
        preset: box, threshold and mask smoothing.

    Returns:
        smoothed relevancy [S, H, W], dtype of ``relevancy``, and masks [S, H, W] boolean.
    """
    relevancy = _checked(relevancy)
    smoothed = 0.5 * (relevancy + box_mean(relevancy, preset.kernel, preset.border))
    above = torch.stack([rescale(level) > preset.threshold for level in smoothed])
    return smoothed, box_mean(above.float(), preset.smoothing) > 0.5


def choose_level(smoothed: Tensor, masks: Tensor, choice: LevelChoice) -> int:
    """Position of the level that answers (protocols.md, LERF-OVS, step 4); the first of equals.

    With "mask", a level with an empty mask is never chosen, unless all are empty: then the peak decides.

    Args:
        smoothed, masks: [S, H, W] each, from ``level_masks``.
        choice: see ``QueryPreset``.
    """
    areas = masks.flatten(1).sum(1)
    if choice == "peak" or not areas.any():
        return int(smoothed.flatten(1).amax(1).argmax())
    # float64, so that levels alike to the last bit give equal means.
    sums = torch.where(masks, smoothed.double(), 0.0).flatten(1).sum(1)
    return int(torch.where(areas > 0, sums / areas, -torch.inf).argmax())


def rescale(values: Tensor) -> Tensor:
    """Stretch values of any shape to 0..1 and cut the lower half off: clip(2 n - 1, 0, 1) with
    n = (v - min) / (max - min + 1e-9) (protocols.md, LERF-OVS, step 2). Constant values become 0."""
    low, high = values.min(), values.max()
    # float64, in which 1e-9 does not vanish beside the range.
    stretched = (values.double() - low) / (high.double() - low + 1e-9)
    return (2 * stretched - 1).clamp(0, 1).to(values.dtype)


def mask_box(mask: Tensor) -> tuple[int, int, int, int] | None:
    """(x0, y0, x1, y1) around the true pixels of [H, W], x1 and y1 one past the last; None if there are
    none.
    """
    rows = mask.any(1).nonzero()[:, 0]
    columns = mask.any(0).nonzero()[:, 0]
    if not len(rows):
        return None
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


def box_mean(maps: Tensor, kernel: int, border: Border = "inside") -> Tensor:
    """Mean over a kernel x kernel box around each pixel, same size as the input.

    The box of pixel x covers x - kernel // 2 ... x - kernel // 2 + kernel - 1 on each axis; for even kernels
    this is where OpenCV's filter2D puts it. Summed in float64, so that equal neighbourhoods give equal
    means.

    Args:
        maps: [..., H, W] floating point; may be smaller than the kernel.
        kernel: side of the box in pixels.
        border: see ``QueryPreset``.
    """
    means = maps.double()
    for axis in (-1, -2):
        means = _mean_along(means, axis, kernel, border)
    return means.to(maps.dtype)


def _mean_along(values: Tensor, axis: int, kernel: int, border: Border) -> Tensor:
    """[..., H, W] float64 running means along one axis, by differences of running sums."""
    size = values.shape[axis]
    before, after = kernel // 2, kernel - 1 - kernel // 2
    counts: Tensor | int = kernel
    if border == "reflect":
        values = values.index_select(axis, _reflected(size, before, after).to(values.device))
        before = after = 0
    else:
        position = torch.arange(size, device=values.device)
        counts = (position + after).clamp(max=size - 1) - (position - before).clamp(min=0) + 1
        counts = counts.view([-1] + [1] * (-axis - 1))
    padding = [0, 0] * (-axis - 1) + [before + 1, after]
    sums = torch.nn.functional.pad(values, padding).cumsum(axis)
    return (sums.narrow(axis, kernel, size) - sums.narrow(axis, 0, size)) / counts


def _reflected(size: int, before: int, after: int) -> Tensor:
    """Source of each position from -before to size + after, mirrored about the edge pixels as often as
    needed.
    """
    positions = torch.arange(-before, size + after)
    period = max(2 * (size - 1), 1)
    positions = positions % period
    return torch.minimum(positions, period - positions) if size > 1 else torch.zeros_like(positions)


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
    from scoup.neighbours import Neighbourhood

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
