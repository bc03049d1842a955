"""The systems compared with, by name: what each follows of its paper, where it departs, and how it is made here.

All share the rasteriser, the regions, the text vectors and the queries of the method itself, so that scores differ by
what is compared and nothing else. They are written from the papers' descriptions: figures of the systems' own code are
theirs alone.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError, looked_up
from scoup.base.progress import Progress, no_progress
from scoup.baselines.autoencoder import LANGSPLAT, AutoencoderSettings, fit_autoencoder
from scoup.baselines.channels import ChannelField, code_cosines, embedding_cosines
from scoup.baselines.dense import weighted_means
from scoup.baselines.pixel_rules import CentrePixel, Gather, TopContributors, VisibleCentrePixel
from scoup.baselines.product_quantisation import fit_product_quantiser
from scoup.scene.codes import SparseCodes
from scoup.uplift.build_settings import BUILD_PRESETS, BuildSettings
from scoup.uplift.region_codes import learn_codebook
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.vote import GaussianCodes, vote

Make = Callable[[RegionSums, Sequence[Tensor], "MethodSettings"], ChannelField]
"""``make(sums, embeddings, settings)``: region sums of the method's own gathering, embeddings [R, D] of each level."""


@dataclass(frozen=True)
class MethodSettings:
    """What the methods may be told.

    Attributes:
        seed: of all that is random.
        build: of the sparse codes.
        quantised_parts: bytes of a quantised feature; 0 takes 64, or the largest divisor of D below.
        autoencoder: schedule of LangSplat's network.
        progress: told while the network is trained.
    """

    seed: int = 0
    build: BuildSettings = BUILD_PRESETS["default"]
    quantised_parts: int = 0
    autoencoder: AutoencoderSettings = LANGSPLAT
    progress: Progress = no_progress


DEFAULTS = MethodSettings()


@dataclass(frozen=True, eq=False)
class Method:
    """A way to carry the embeddings of regions onto Gaussians.

    Attributes:
        name: short.
        system: whose idea.
        follows, departs: of it.
        gather: which weights count; None counts all blending weights.
        make: from region sums to something that can be asked.
    """

    name: str
    system: str
    follows: str
    departs: str
    gather: Gather | None
    make: Make


def dense_field(sums: RegionSums, embeddings: Sequence[Tensor], settings: MethodSettings) -> ChannelField:
    """The weighted mean of embeddings of each Gaussian, scaled to unit norm."""
    features = weighted_means(sums, embeddings)
    size = 4.0 * sum(rows.shape[1] for rows in features)
    return ChannelField(features, [embedding_cosines] * len(features), size)


def quantised_field(sums: RegionSums, embeddings: Sequence[Tensor], settings: MethodSettings) -> ChannelField:
    """Dense features kept as product-quantised codes. Asked by their decoded form."""
    features = []
    dim = embeddings[0].shape[1]
    parts = settings.quantised_parts or _parts_of(dim)
    shared = 0.0
    for level, rows in enumerate(weighted_means(sums, embeddings)):
        quantiser = fit_product_quantiser(embeddings[level], parts, settings.seed)
        known = rows.any(1)
        features.append(torch.zeros_like(rows))
        features[-1][known] = quantiser.decode(quantiser.encode(rows[known]))
        shared += 4.0 * quantiser.centroids.size
    return ChannelField(features, [embedding_cosines] * len(features), float(parts * len(features)), shared)


def autoencoded_field(
    sums: RegionSums, embeddings: Sequence[Tensor], settings: MethodSettings
) -> ChannelField:
    """The weighted mean of three numbers a region; a network turns what is rendered of them into embeddings again."""
    network = fit_autoencoder(
        torch.cat(list(embeddings)), settings.autoencoder, settings.seed, settings.progress
    )
    codes = weighted_means(sums, [network.encode(rows) for rows in embeddings])

    def cosines(rows: Tensor, queries: Tensor) -> Tensor:
        return network.decode(rows) @ queries.T

    shared = 4.0 * sum(parameter.numel() for parameter in network.decoder.parameters())
    return ChannelField(codes, [cosines] * len(codes), 4.0 * network.code_size * len(codes), shared)


def sparse_field(sums: RegionSums, embeddings: Sequence[Tensor], settings: MethodSettings) -> ChannelField:
    """Sparse codes by the settings of a build, as ``scoup.build`` makes them."""
    codes, codebook = learn_codes(embeddings, replace(settings.build, seed=settings.seed))
    return voted_field(voted(sums, codes, codebook, settings.build), codebook, not settings.build.keep)


def learn_codes(embeddings: Sequence[Tensor], settings: BuildSettings) -> tuple[list[SparseCodes], Tensor]:
    """Codes of the regions of each level, and codebook [S, L, D], by the settings of a build.

    Raises:
        InputError: the settings ask for consensus.
    """
    if settings.consensus:
        raise InputError("consensus is not compared here; build without it")
    books = [learn_codebook(rows, settings) for rows in embeddings]
    return [book.codes for book in books], torch.stack([book.atoms for book in books])


def voted(
    sums: RegionSums,
    codes: Sequence[SparseCodes],
    codebook: Tensor,
    settings: BuildSettings,
    all_kept: bool = False,
) -> GaussianCodes:
    """The vote by the settings of a build; ``all_kept`` keeps every atom whatever they say."""
    keep = None if all_kept else settings.keep or None
    return vote(sums, codes, codebook, settings.rounds, keep, settings.keep or settings.k)


def voted_field(found: GaussianCodes, codebook: Tensor, all_kept: bool) -> ChannelField:
    """What a vote has found, over a codebook [S, L, D]; half precision as on disk."""
    return coded_field(found.indices, found.weights.half(), codebook, all_kept)


def coded_field(indices: Tensor, weights: Tensor, codebook: Tensor, all_kept: bool = False) -> ChannelField:
    """Codes as a field stores them: indices [N, S, K], weights [N, S, K] float16, codebook [S, L, D]."""
    n_levels, n_atoms = codebook.shape[:2]
    values = [
        SparseCodes(indices[:, level], weights[:, level].float(), n_atoms).to_dense()
        for level in range(n_levels)
    ]
    # With all atoms kept their indices need not be stored.
    each = 2.0 * n_atoms if all_kept else (2.0 + indices.element_size()) * indices.shape[2]
    return ChannelField(
        values,
        [code_cosines(atoms) for atoms in codebook],
        each * n_levels,
        4.0 * codebook.numel(),
        lambda view, words: raster.render_cosines(view, indices, weights, codebook, words),
    )


def _parts_of(dim: int) -> int:
    return next(parts for parts in range(min(64, dim), 0, -1) if dim % parts == 0)


def _with(**changes: object) -> Make:
    """``sparse_field`` with some settings of the build changed."""

    def make(sums: RegionSums, embeddings: Sequence[Tensor], settings: MethodSettings) -> ChannelField:
        return sparse_field(
            sums,
            embeddings,
            replace(settings, build=replace(settings.build, **changes)),  # pyright: ignore[reportArgumentType]
        )

    return make


_OURS = (
    Method(
        "sparse",
        "SCOUP, as this package builds by default",
        "Sparse codes lifted by blending weights, top-K vote.",
        "Exact coding, 128 atoms and a second round of the vote, where the paper has Adam, 64 and one.",
        None,
        sparse_field,
    ),
    Method(
        "sparse-64",
        "SCOUP, 64 atoms and one round",
        "The paper's sizes and vote.",
        "Exact coding in place of Adam.",
        None,
        _with(n_atoms=64, rounds=1),
    ),
    Method(
        "sparse-64-all",
        "SCOUP, 64 atoms, no top-K",
        "The paper's ablation: all atoms of a Gaussian are kept.",
        "Exact coding in place of Adam.",
        None,
        _with(n_atoms=64, rounds=1, keep=0),
    ),
)
_OTHERS = (
    Method(
        "dense",
        "LUDVIG",
        "Features of pixels averaged over views by blending weights, 512 numbers a level.",
        "No graph diffusion; features are embeddings of regions, at three levels, not maps of pixels.",
        None,
        dense_field,
    ),
    Method(
        "centre-pixel",
        "Occam's LGS",
        "Each Gaussian gathers the embedding at the pixel of its projected centre, one a view, weighted by its own "
        "blending weight there; 512 numbers a level.",
        "No filtering of Gaussians beyond those that paint nothing at their centre; scores of other "
        "pixels are not used.",
        CentrePixel(),
        dense_field,
    ),
    Method(
        "visible-centre-pixel",
        "VALA",
        "Centre pixels gated by visibility: a Gaussian counts in a view only if it is among those that make up half of "
        "the pixel's painted weight; 512 numbers a level.",
        "The gate's share of one half is our choice. Views are put together by a weighted mean; what the paper does "
        "beyond the gate is not here.",
        VisibleCentrePixel(),
        dense_field,
    ),
    Method(
        "top-contributors",
        "Dr. Splat",
        "Each pixel's embedding goes to the Gaussians that paint most of it, weighted by how much; kept as "
        "product-quantised codes.",
        "Ten Gaussians a pixel and 64 bytes a level are our choice; the quantiser learns from the scene's own regions, "
        "not from a large image collection, by k-means in numpy instead of faiss. It is also scored in "
        "2D here, where the paper selects in 3D.",
        TopContributors(),
        quantised_field,
    ),
    Method(
        "autoencoder",
        "LangSplat",
        "LangSplat's autoencoder to three numbers and back, decoded for every pixel.",
        "The three numbers are lifted as weighted means; LangSplat optimises them through the "
        "rasteriser, each level by itself.",
        None,
        autoencoded_field,
    ),
)
METHODS: dict[str, Method] = {method.name: method for method in (*_OURS, *_OTHERS)}
"""By name."""


def find_method(name: str) -> Method:
    """A method by name.

    Raises:
        UnknownNameError: there is none.
    """
    return looked_up("method", name, METHODS)
