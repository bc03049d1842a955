"""The methods by name: our presets, and the systems we compare with, as we reimplement them.

Baselines are written from the papers' descriptions, and where they name constants of public code, from reading it: none
of their scores here is a figure of a system's own code.
"""

from __future__ import annotations

from scoup.base import Registry
from scoup_lab.baselines.dense import dense_mean_uplift, dense_uplift
from scoup_lab.baselines.method import Method
from scoup_lab.baselines.pixel_rules import AllPixels, CentrePixel, TopContributors, VisibleInView
from scoup_lab.baselines.sparse import SparseUplift
from scoup_lab.baselines.trained import QuantisedUplift, autoencoded_uplift, joint_uplift
from scoup_lab.baselines.visible_median import median_uplift

PRESETS = (
    Method(
        "sparse",
        SparseUplift(),
        "SCOUP, as this package builds by default",
        "Sparse codes lifted by blending weights, top-K vote.",
        "Exact coding, 128 atoms, a second round, things, and region sums of at most 500 pixels; the paper has Adam, "
        "64, one round and full size.",
        AllPixels("auto"),
    ),
    Method(
        "sparse-64",
        SparseUplift(n_atoms=64, k=4, rounds=1, effort="best", things=False),
        "SCOUP, 64 atoms and one round",
        "The paper's sizes and vote.",
        "Exact coding in place of Adam.",
    ),
    Method(
        "sparse-64-all",
        SparseUplift(n_atoms=64, k=4, rounds=1, effort="best", keep=0, things=False),
        "SCOUP, 64 atoms, no top-K",
        "The paper's ablation: all atoms of a Gaussian are kept.",
        "Exact coding in place of Adam.",
    ),
    Method(
        "paper",
        SparseUplift(n_atoms=64, k=4, rounds=1, solver="adam", scale=1.0, things=False),
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
        "Features of pixels averaged over views by blending weights, 512 numbers per level.",
        "No graph diffusion; features are embeddings of regions, at three levels, not maps of pixels; each Gaussian's "
        "mean is scaled to unit norm before it is rendered.",
        random=False,
    ),
    Method(
        "dense-mean",
        dense_mean_uplift,
        "SCOUP, dense uplift as published",
        "Eq. 3 of the paper: the mean of embeddings by blending weights, not scaled; 512 numbers per level.",
        "Only pixels with a region count, in the sum and in its normaliser.",
        random=False,
    ),
    Method(
        "centre-pixel",
        dense_uplift,
        "Occam's LGS",
        "Each Gaussian gathers the embedding at the pixel of its projected centre, one a view, weighted by its own "
        "blending weight there; 512 numbers per level.",
        "No filtering of Gaussians beyond those that contribute nothing at their centre; scores of other "
        "pixels are not used.",
        CentrePixel(),
        random=False,
    ),
    Method(
        "visible-centre-median",
        median_uplift,
        "VALA, its public code and constants",
        "Of the Gaussians of a view, those heaviest at their centre pixels: 75 % of the sum of these weights, each "
        "0.13 or more; views put together by the streaming weighted median of directions.",
        "Gaussians that no view lets pass stay in the scene without a feature; theirs are removed.",
        VisibleInView(),
        random=False,
    ),
    Method(
        "top-45-contributors",
        QuantisedUplift(),
        "Dr. Splat, its published constants",
        "Each pixel's embedding goes to the 45 Gaussians that contribute most to it, weighted by how much; stored as "
        "product-quantised codes of 128 bytes per level.",
        "The quantiser learns from the scene's own regions, not from a large image collection, by k-means in numpy "
        "instead of faiss. It is also scored in 2D here, where the paper selects in 3D.",
        TopContributors(),
    ),
    Method(
        "autoencoder",
        autoencoded_uplift,
        "LangSplat",
        "LangSplat's autoencoder to three numbers and back, decoded for every pixel.",
        "The three numbers are lifted as weighted means; LangSplat optimises them through the "
        "rasteriser, each level by itself.",
        trained_by="autoencoder",
    ),
    Method(
        "joint-codes",
        joint_uplift,
        "LangSplatV2, our reimplementation",
        "Codebook and codes of Gaussians learned together through renderings by Adam: 64 atoms, 4 kept, 10000 steps a "
        "level, cosine loss.",
        "Views 120 pixels wide with their blending weights kept as sparse matrices, on the CPU; spherical k-means.",
        trained_by="joint",
    ),
)
METHODS = Registry("method", "scoup_lab.baselines", Method, (*PRESETS, *BASELINES))
"""By name."""
COMPARED = tuple(method.name for method in (*PRESETS, *BASELINES) if method.name != "joint-codes")
"""Methods compared by default: without the slowest."""
