"""Colours: for amounts, for labels, and for codes."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import InputError

Picture: TypeAlias = NDArray[np.uint8]
"""[H, W, 3] sRGB."""

ArrayOrTensor: TypeAlias = "np.ndarray | Tensor"

# From dark violet over red and orange to light yellow: lightness rises evenly, so it reads in print and for
# the colour-blind, and its low end is dark enough to fade into a photograph.
_HEAT = np.array(
    [
        (0, 0, 4), (31, 12, 72), (85, 15, 109), (136, 34, 106), (186, 54, 85), (227, 89, 51), (249, 140, 10),
        (249, 201, 50), (252, 255, 164),
    ],
    dtype=np.float64,
)  # fmt: skip
_LIGHTNESS = np.array([0.299, 0.587, 0.114])
_GOLDEN = 0.61803398875
BACKDROP = 0.62  # brightness of the grey render under a heat map
STRONGEST = 0.92  # opacity of the heat where relevancy is highest


def as_array(values: ArrayOrTensor) -> np.ndarray:
    """Return a numpy array of a tensor (from any device) or of an array."""
    return values.detach().cpu().numpy() if isinstance(values, Tensor) else np.asarray(values)


def as_picture(image: ArrayOrTensor) -> Picture:
    """Return [H, W, 3] uint8 of a colour image: uint8, or float 0..1 (cut off outside; not finite counts as 0)."""
    array = as_array(image)
    if array.ndim != 3 or array.shape[2] != 3 or not array.size:
        raise InputError(f"a colour image is [H, W, 3] and not empty, got {list(array.shape)}")
    if array.dtype == np.uint8:
        return array
    if not np.issubdtype(array.dtype, np.floating):
        raise InputError(f"a colour image is uint8 or floating point, got {array.dtype}")
    return (np.nan_to_num(array, posinf=0, neginf=0).clip(0, 1) * 255 + 0.5).astype(np.uint8)


def heat_colors(amounts: ArrayOrTensor) -> NDArray[np.float64]:
    """Return [..., 3] sRGB 0..255 of amounts [...] 0..1: from near black over red to light yellow."""
    position = np.nan_to_num(as_array(amounts).astype(np.float64)).clip(0, 1) * (len(_HEAT) - 1)
    low = np.minimum(position.astype(int), len(_HEAT) - 2)
    share = (position - low)[..., None]
    return _HEAT[low] * (1 - share) + _HEAT[low + 1] * share


def heat_amounts(relevancy: np.ndarray, span: tuple[float, float]) -> NDArray[np.float64]:
    """Return the place of each relevancy between the two ends of the span, 0..1; 0 if the ends are equal."""
    low, high = span
    if high - low <= 1e-6:
        return np.zeros(relevancy.shape)
    return ((relevancy - low) / (high - low)).clip(0, 1)


def heat_opacity(amounts: np.ndarray) -> NDArray[np.float64]:
    """Return the opacity of the heat, 0..1: none at the low end, so that the picture stays clear there."""
    share = ((amounts - 0.08) / 0.5).clip(0, 1)
    return share * share * (3 - 2 * share)


def grey(picture: Picture) -> NDArray[np.float64]:
    """Return [H, W, 1] lightness 0..255."""
    return (picture.astype(np.float64) @ _LIGHTNESS)[..., None]


def label_colors(count: int) -> Picture:
    """Return [count, 3] uint8 colours that are easy to tell apart, the same for the same number each time."""
    number = np.arange(count)
    hue = (0.07 + number * _GOLDEN) % 1.0
    saturation = np.array([0.62, 0.85, 0.48])[number % 3]
    value = np.array([0.95, 0.78, 0.9, 0.65])[number % 4]
    sector = (hue[:, None] * 6 + np.array([5.0, 3.0, 1.0])) % 6
    share = np.minimum(np.minimum(sector, 4 - sector), 1).clip(0)
    return (value[:, None] * (1 - saturation[:, None] * share) * 255 + 0.5).astype(np.uint8)


def code_basis(codes: ArrayOrTensor) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the basis that turns codes [..., L] into colours: ``code_picture`` of several views with one basis can be
    compared. All-zero rows are left out.

    Returns:
        [L + 1, 3] an affine map from codes to three principal components (the last row is added), and [2, 3] their
        ranges.
    """
    rows = as_array(codes).reshape(-1, codes.shape[-1]).astype(np.float64)
    rows = rows[(rows != 0).any(1)]
    length = codes.shape[-1]
    axes = np.zeros((length, 3))
    if not len(rows):
        return np.concatenate([axes, np.zeros((1, 3))]), np.array([[0.0] * 3, [1.0] * 3])
    # Each leading atom has the same weight: walls would take all the colours otherwise.
    leading = rows.argmax(1)
    weights = 1.0 / np.bincount(leading, minlength=length)[leading]
    weights /= weights.sum()
    mean = weights @ rows
    _, vectors = np.linalg.eigh((rows - mean).T @ ((rows - mean) * weights[:, None]))
    principal = vectors[:, ::-1][:, : min(3, length)]
    # The sign of a component is arbitrary; its largest entry is made positive.
    principal = principal * np.sign(principal[np.abs(principal).argmax(0), np.arange(principal.shape[1])])
    axes[:, : principal.shape[1]] = principal
    components = (rows - mean) @ axes
    order = np.argsort(components, axis=0, kind="stable")
    heaped = np.cumsum(weights[order], axis=0)
    low, high = (
        np.array(
            [
                components[order[np.searchsorted(heaped[:, c], share).clip(max=len(rows) - 1), c], c]
                for c in range(3)
            ]
        )
        for share in (0.03, 0.97)
    )
    affine = np.concatenate([axes, -(mean @ axes)[None]])
    return affine, np.stack([low, np.where(high - low > 1e-9, high, low + 1.0)])


def code_picture(
    codes: ArrayOrTensor, basis: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
) -> Picture:
    """Return codes [H, W, L], for example one level of ``render_codes``, as colours: three principal components
    (``code_basis``, by default of these codes) as red, green and blue. Pixels without a code are black."""
    array = as_array(codes).astype(np.float64)
    if array.ndim != 3 or not array.size:
        raise InputError(f"codes of a view are [H, W, L] and not empty, got {list(array.shape)}")
    affine, (low, high) = basis if basis is not None else code_basis(array)
    shown = (array @ affine[:-1] + affine[-1] - low) / (high - low)
    shown = 0.08 + 0.9 * shown.clip(0, 1)
    return as_picture(np.where((array != 0).any(2)[..., None], shown, 0.0))
