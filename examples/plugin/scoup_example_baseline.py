"""A baseline, which SCOUP compares with its own methods once this package is installed:

scoup eval baselines ROOT --methods sparse --methods heaviest-region
"""

import numpy as np

from scoup_lab.baselines.dense import fitted_embeddings
from scoup_lab.baselines.method import Method


def heaviest_region(inputs, settings):
    """Each Gaussian takes the embedding of the one region that it contributes most to."""
    features = []
    for level, embeddings in enumerate(inputs.embeddings):  # [R, D] each
        sums = inputs.sums.matrix(level)  # [N, R] sparse: contributions to regions, summed over the views
        chosen = embeddings[np.asarray(sums.argmax(axis=1)).ravel()]
        chosen[sums.sum(axis=1) == 0] = 0  # Gaussians that no region shows
        features.append(chosen)
    return fitted_embeddings(features)


HEAVIEST_REGION = Method(
    "heaviest-region",
    heaviest_region,
    system="an example",
    follows="One region for each Gaussian, instead of a mean over regions.",
    departs="Nothing: it has no paper.",
    random=False,
)
