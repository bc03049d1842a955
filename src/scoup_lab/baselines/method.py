"""Methods: ways from a rasterised scene to relevancy. Our presets, ablations and baselines are all methods, and tables,
studies treat them alike.

All share the rasteriser, the regions, the text vectors and the queries, so that scores differ by what is compared and
nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from scoup.base import Entry, Progress, no_progress
from scoup.uplift import BuildSettings
from scoup_lab.baselines.autoencoder import LANGSPLAT, AutoencoderSettings
from scoup_lab.baselines.fitted import FittedMethod
from scoup_lab.baselines.joint_codes import LANGSPLATV2, JointSettings
from scoup_lab.baselines.pixel_rules import ALL_PIXELS, PixelRule
from scoup_lab.baselines.rasterised_scene import RasterisedScene, UpliftInputs


@dataclass(frozen=True)
class MethodSettings:
    """Settings of all methods."""

    seed: int = 0  # of all that is random
    build: BuildSettings = field(
        default_factory=BuildSettings
    )  # of the sparse codes; methods may change some of it
    autoencoder: AutoencoderSettings = LANGSPLAT  # schedule of LangSplat's network
    joint: JointSettings = LANGSPLATV2  # schedule of codes learned through renderings (LangSplatV2)
    progress: Progress = no_progress  # called while a method is fitted


DEFAULTS = MethodSettings()

Uplift = Callable[[UpliftInputs, MethodSettings], FittedMethod]
"""From region sums and embeddings to what gives relevancy."""


@dataclass(frozen=True, eq=False)
class Method(Entry):
    """A way to carry the embeddings of regions onto Gaussians."""

    uplift: Uplift  # what becomes of the region sums and embeddings
    system: str = "SCOUP"  # whose idea
    # follows, departs: what of it is followed, and where this departs
    follows: str = ""
    departs: str = ""
    pixels: PixelRule = ALL_PIXELS  # which pixels count for which Gaussians
    random: bool = True  # whether the result depends on the seed
    trained_by: Literal["", "autoencoder", "joint"] = ""  # the settings of its training, if it is trained

    def title(self, settings: MethodSettings) -> str:
        """Return the name, and what is not run as published."""
        departure = getattr(settings, self.trained_by).departure() if self.trained_by else ""
        return f"{self.name} ({departure})" if departure else self.name

    def fit(self, scene: RasterisedScene, settings: MethodSettings = DEFAULTS) -> FittedMethod:
        """Fit to a scene; the scene keeps region sums and codes for the next method."""
        return self.uplift(scene.inputs(self.pixels, settings.progress), settings)
