"""VALA's way of putting views together: a streaming weighted geometric median in the space of directions.

View by view, each Gaussian moves its direction g towards the view's f, across g alone, by the view's share w of the
weight W so far, and is scaled to unit norm again:

    W <- W + w,    g <- normalise(g + (w / W) (f - (f . g) g)).

From VALA's public code (``GaussianModel.accumulate_gaussian_feature_per_view_robust``), which calls that a median in
cosine space (paper: arXiv 2509.05515). The first view gives g = f. The outcome depends on the order of the views.
"""

from __future__ import annotations

import torch
from scipy.sparse import csr_array
from torch import Tensor

from scoup.base import InputError
from scoup.scene import normalise_embeddings
from scoup.uplift import RegionSums
from scoup_lab.baselines.dense import fitted_embeddings
from scoup_lab.baselines.fitted import FittedChannels
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.rasterised_scene import UpliftInputs


def streaming_median(sums: RegionSums, embeddings: Tensor, level: int) -> Tensor:
    """Return [N, D] float32 unit rows, zero where nothing was seen.

    ``embeddings``: [R, D] of the regions of the level, any norm.
    """
    if sums.rows is None:
        raise InputError("the rows of each view are not known (RegionSums.select)")
    unit = normalise_embeddings(embeddings.cpu())
    medians = torch.zeros(sums.n_gaussians, unit.shape[1])
    total = torch.zeros(sums.n_gaussians, 1)
    for view, rows in sums.rows[level].items():
        gaussian, region, weight = sums.triplets(view, level)
        of_view = csr_array(
            (weight, (gaussian, region)), shape=(sums.n_gaussians, rows.stop - rows.start), dtype="float32"
        )
        seen = torch.from_numpy(of_view.sum(1) > 0).nonzero()[:, 0]
        weights = of_view[seen.numpy()]
        towards = torch.nn.functional.normalize(torch.from_numpy(weights @ unit[rows].numpy()), dim=1)
        share = torch.from_numpy(weights.sum(1))[:, None]
        total[seen] += share
        before = medians[seen]
        across = towards - (towards * before).sum(1, keepdim=True) * before
        medians[seen] = torch.nn.functional.normalize(before + share / total[seen] * across, dim=1)
    return medians


def median_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
    """Return the streaming median of embeddings of each Gaussian."""
    rows = enumerate(inputs.embeddings)
    return fitted_embeddings([streaming_median(inputs.sums, of_level, level) for level, of_level in rows])
