"""The methods by name: our presets, and the systems we compare with, as we reimplement them.

Baselines are written from the papers' descriptions: none of their scores here is a figure of a system's own code.
"""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.base.errors import looked_up
from scoup.baselines.autoencoder import fit_autoencoder
from scoup.baselines.dense import dense_uplift, weighted_means
from scoup.baselines.fitted import FittedChannels, embedding_cosines
from scoup.baselines.method import Method, MethodSettings
from scoup.baselines.pixel_rules import CentrePixel, TopContributors, VisibleCentrePixel
from scoup.baselines.product_quantisation import fit_product_quantiser
from scoup.baselines.rasterised_scene import UpliftInputs
from scoup.baselines.sparse import SparseUplift


def quantised_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
    """Dense features stored as product-quantised codes, and compared in their decoded form."""
    features = []
    dim = inputs.embeddings[0].shape[1]
    parts = settings.quantised_parts or next(n for n in range(min(64, dim), 0, -1) if dim % n == 0)
    shared = 0.0
    for level, rows in enumerate(weighted_means(inputs.sums, inputs.embeddings)):
        quantiser = fit_product_quantiser(inputs.embeddings[level], parts, settings.seed)
        known = rows.any(1)
        features.append(torch.zeros_like(rows))
        features[-1][known] = quantiser.decode(quantiser.encode(rows[known]))
        shared += 4.0 * quantiser.centroids.size
    return FittedChannels(features, [embedding_cosines] * len(features), float(parts * len(features)), shared)


def autoencoded_uplift(inputs: UpliftInputs, settings: MethodSettings) -> FittedChannels:
    """The weighted mean of three numbers a region; a network decodes what is rendered of them into embeddings."""
    network = fit_autoencoder(
        torch.cat(list(inputs.embeddings)), settings.autoencoder, settings.seed, settings.progress
    )
    codes = weighted_means(inputs.sums, [network.encode(rows) for rows in inputs.embeddings])

    def cosines(rows: Tensor, queries: Tensor) -> Tensor:
        return network.decode(rows) @ queries.T

    shared = 4.0 * sum(parameter.numel() for parameter in network.decoder.parameters())
    return FittedChannels(codes, [cosines] * len(codes), 4.0 * network.code_size * len(codes), shared)


PRESETS = (
    Method(
        "sparse",
        SparseUplift(),
        "SCOUP, as this package builds by default",
        "Sparse codes lifted by blending weights, top-K vote.",
        "Exact coding, 128 atoms, wide codes and a second round of the vote; the paper has Adam, 64 and one round.",
    ),
    Method(
        "sparse-all",
        SparseUplift(keep=0),
        "SCOUP, as this package builds by default, no top-K",
        "Sparse codes lifted by blending weights; all atoms of a Gaussian are kept.",
        "Exact coding, 128 atoms, wide codes and a second round of the vote; the paper has Adam, 64 and one round.",
    ),
    Method(
        "sparse-64",
        SparseUplift(n_atoms=64, k=4, wide=False, rounds=1, effort="best"),
        "SCOUP, 64 atoms and one round",
        "The paper's sizes and vote.",
        "Exact coding in place of Adam.",
    ),
    Method(
        "sparse-64-all",
        SparseUplift(n_atoms=64, k=4, wide=False, rounds=1, effort="best", keep=0),
        "SCOUP, 64 atoms, no top-K",
        "The paper's ablation: all atoms of a Gaussian are kept.",
        "Exact coding in place of Adam.",
    ),
    Method(
        "paper",
        SparseUplift(n_atoms=64, k=4, wide=False, rounds=1, solver="adam"),
        "SCOUP, as published",
        "Adam, 64 atoms, top-K vote, one round.",
        "Full batches, atoms from spherical k-means and first logits from cosines are our choices.",
    ),
)
BASELINES = (
    Method(
        "dense",
        dense_uplift,
        "LUDVIG",
        "Features of pixels averaged over views by blending weights, 512 numbers a level.",
        "No graph diffusion; features are embeddings of regions, at three levels, not maps of pixels.",
        random=False,
    ),
    Method(
        "centre-pixel",
        dense_uplift,
        "Occam's LGS",
        "Each Gaussian gathers the embedding at the pixel of its projected centre, one a view, weighted by its own "
        "blending weight there; 512 numbers a level.",
        "No filtering of Gaussians beyond those that paint nothing at their centre; scores of other "
        "pixels are not used.",
        CentrePixel(),
        random=False,
    ),
    Method(
        "visible-centre-pixel",
        dense_uplift,
        "VALA",
        "Centre pixels gated by visibility: a Gaussian counts in a view only if it is among those that make up half of "
        "the pixel's painted weight; 512 numbers a level.",
        "The gate's share of one half is our choice. Views are put together by a weighted mean; what the paper does "
        "beyond the gate is not here.",
        VisibleCentrePixel(),
        random=False,
    ),
    Method(
        "top-contributors",
        quantised_uplift,
        "Dr. Splat",
        "Each pixel's embedding goes to the Gaussians that paint most of it, weighted by how much; stored as "
        "product-quantised codes.",
        "Ten Gaussians a pixel and 64 bytes a level are our choice; the quantiser learns from the scene's own regions, "
        "not from a large image collection, by k-means in numpy instead of faiss. It is also scored in "
        "2D here, where the paper selects in 3D.",
        TopContributors(),
    ),
    Method(
        "autoencoder",
        autoencoded_uplift,
        "LangSplat",
        "LangSplat's autoencoder to three numbers and back, decoded for every pixel.",
        "The three numbers are lifted as weighted means; LangSplat optimises them through the "
        "rasteriser, each level by itself.",
    ),
)
METHODS: dict[str, Method] = {method.name: method for method in (*PRESETS, *BASELINES)}
"""By name."""
COMPARED = tuple(name for name in METHODS if name not in ("sparse-all", "paper"))
"""Those compared by default. The ablations cover the others, and Adam takes minutes."""


def find_method(name: str) -> Method:
    """A method by name.

    Raises:
        UnknownNameError: there is none.
    """
    return looked_up("method", name, METHODS)
