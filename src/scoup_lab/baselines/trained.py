"""Methods that learn for a scene: LangSplat's autoencoder, quantised features, codes learned through renderings."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import InputError
from scoup_lab.baselines.autoencoder import fit_autoencoder
from scoup_lab.baselines.dense import weighted_means
from scoup_lab.baselines.fitted import FittedChannels, FittedField, embedding_cosines, fitted_field
from scoup_lab.baselines.joint_codes import JointCodes, fit_joint_codes
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.product_quantisation import fit_product_quantiser
from scoup_lab.baselines.rasterised_scene import UpliftInputs
from scoup_lab.baselines.view_weights import weights_of_views


@dataclass(frozen=True)
class QuantisedUplift:
    """Dense features stored as product-quantised codes, and compared in their decoded form."""

    parts: int = 128  # M, bytes of a feature; where D is no multiple of it, the largest divisor of D below

    def __call__(self, inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
        features = []
        dim = inputs.embeddings[0].shape[1]
        parts = next(n for n in range(min(self.parts, dim), 0, -1) if dim % n == 0)
        shared = 0.0
        for level, rows in enumerate(weighted_means(inputs.sums, inputs.embeddings)):
            quantiser = fit_product_quantiser(inputs.embeddings[level], parts, settings.seed)
            known = rows.any(1)
            features.append(torch.zeros_like(rows))
            features[-1][known] = quantiser.decode(quantiser.encode(rows[known]))
            shared += 4.0 * quantiser.centroids.size
        return FittedChannels(
            features, [embedding_cosines] * len(features), float(parts * len(features)), shared
        )


def autoencoded_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
    """Return the weighted mean of three numbers a region; a network decodes renders of them to embeddings."""
    rows = torch.cat(list(inputs.embeddings))
    network = fit_autoencoder(rows, settings.autoencoder, settings.seed, settings.progress)
    codes = weighted_means(inputs.sums, [network.encode(of_level) for of_level in inputs.embeddings])

    def cosines(rows: Tensor, queries: Tensor) -> Tensor:
        return network.decode(rows) @ queries.T

    shared = 4.0 * sum(parameter.numel() for parameter in network.decoder.parameters())
    return FittedChannels(codes, [cosines] * len(codes), 4.0 * network.code_size * len(codes), shared)


def learn_joint_codes(inputs: UpliftInputs, settings: MethodSettings) -> JointCodes:
    """Learn codebook and codes through renderings of the scene."""
    sums, scene = inputs.sums, inputs.scene
    if scene is None or sums.rows is None:
        raise InputError("codes learned through renderings need the scene, not its region sums alone")
    views = weights_of_views(scene, settings.joint.width)
    embeddings, count = inputs.embeddings, sums.n_gaussians
    return fit_joint_codes(
        views, embeddings, sums.rows, count, settings.joint, settings.seed, settings.progress
    )


def joint_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedField:
    """Run ``learn_joint_codes``, and return a field."""
    codes = learn_joint_codes(inputs, settings)
    return fitted_field(inputs.sums, codes.indices, codes.weights, codes.codebook)
