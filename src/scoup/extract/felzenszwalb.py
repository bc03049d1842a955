"""A segmenter without a model: Felzenszwalb's graph-based segmentation at three scales."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.base import ScoupError
from scoup.extract.masks import Masks
from scoup.models import ModelEntry

NAME = "felzenszwalb"
_REFERENCE = 1_000_000  # pixels of an image for which the scales are meant
_SCALES = {"s": (80.0, 250), "m": (300.0, 1500), "l": (900.0, 6000)}  # level -> scale, least region in pixels
_SIGMA = 0.8


class Felzenszwalb:
    """Regions of even colour, from scikit-image; each level covers the whole image.

    They are unrelated to objects: a way from photographs to a field on any machine, not a substitute for SAM.
    """

    cut_last = False
    drop_hidden = False

    def to_dict(self) -> dict[str, Any]:
        scales = {level: list(values) for level, values in _SCALES.items()}
        return {"segmenter": NAME, "scales": scales, "sigma": _SIGMA}

    def segment(self, image: NDArray[np.uint8]) -> dict[str, Masks]:
        try:
            from skimage.segmentation import felzenszwalb
        except ImportError as error:
            raise ScoupError(
                "the segmenter felzenszwalb needs scikit-image: pip install 'scoup[segment]'"
            ) from error
        share = image.shape[0] * image.shape[1] / _REFERENCE
        result = {}
        for level, (scale, least) in _SCALES.items():
            size = max(1, round(least * share))
            labels = felzenszwalb(image, scale * share**0.5, _SIGMA, size, channel_axis=2)
            result[level] = Masks.from_labels(np.asarray(labels, np.int32))
        return result


ENTRY = ModelEntry(
    NAME, lambda *_: Felzenszwalb(), licence="BSD-3-Clause", extra="segment",
    help="no model: regions of even colour at three scales",
)  # fmt: skip
