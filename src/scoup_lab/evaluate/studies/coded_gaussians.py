"""Relevancy where only Gaussians with a code are drawn: at each level the others are taken out of the scene, so that
they hide nothing.

Everywhere else a Gaussian without a code still blends (method.md, stage 2: none is dropped from the scene). Which of
the two the paper means where it removes half of the Gaussians by entropy it does not say.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from scoup import raster
from scoup.field.language_field import LanguageField
from scoup.scene.cameras import Camera
from scoup.scene.codes import rows_of
from scoup.scene.gaussians import Gaussians
from scoup_lab.baselines.fitted import FittedField


def relevancy_of_coded(
    fitted: FittedField,
    gaussians: Gaussians,
    camera: Camera,
    queries: Tensor,
    canonical: Tensor,
    size: tuple[int, int] | None = None,
) -> Tensor:
    """Return [S, Q, H, W] float32 relevancy, each level drawn from the Gaussians that have a code there; 0.5
    where none is.

    ``queries``, ``canonical``: [Q, D] and [P, D], unit norm.
    """
    field, levels = fitted.field, []
    for level, chosen in enumerate(fitted.coded()):
        info = replace(field.info, levels=(field.levels[level],), n_gaussians=int(chosen.sum()))
        part = slice(level, level + 1)
        codes = rows_of(field.code_indices[:, part], chosen), field.code_weights[chosen, part]
        alone = FittedField(LanguageField(*codes, field.codebook[part], info), fitted.all_kept)
        projection = raster.project(gaussians.select(chosen), camera, field.info.raster_preset)
        levels.append(alone.relevancy(projection, queries, canonical, size))
    return torch.cat(levels)
