"""Ways to carry the same embeddings into 3D, asked alike: the method, the method without its vote, dense uplift.

All share one rasterisation (region sums), one set of text vectors and one protocol, so their scores differ by
what is compared and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.base.progress import Progress, no_progress
from scoup.baselines.dense import dense_relevancy, weighted_means
from scoup.evaluate.protocols.lerf_ovs import LabelledFrame, PairScore, SceneScore, score_frame
from scoup.field.language_field import FieldInfo, LanguageField
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.vote import GaussianCodes

Ask = Callable[[Camera, raster.Projection, Tensor, Tensor], Tensor]
"""``ask(camera, view, queries [Q, D], canonical [P, D])`` gives relevancy [S, Q, H, W]."""


@dataclass(frozen=True)
class Variant:
    """One way, by name, with what it has to keep for a Gaussian.

    Attributes:
        name: for tables.
        bytes_per_gaussian: all levels, without the codebook.
        ask: see ``Ask``.
    """

    name: str
    bytes_per_gaussian: float
    ask: Ask


def sparse_variant(
    name: str,
    gaussians: Gaussians,
    codes: GaussianCodes,
    codebook: Tensor,
    raster_preset: str,
    all_kept: bool = False,
) -> Variant:
    """Codes over a codebook [S, L, D]; ``all_kept`` says that they have every atom."""
    indices, weights = codes.indices, codes.weights
    levels = tuple(str(level) for level in range(codebook.shape[0]))
    info = FieldInfo(levels, name, gaussians.fingerprint(), len(gaussians), raster_preset)
    field = LanguageField(indices, weights, codebook, info, gaussians)
    stored = indices.element_size() + field.code_weights.element_size()
    # All atoms kept: their indices need not be stored.
    each = weights.element_size() / 2 if all_kept else stored
    return Variant(
        name,
        each * indices.shape[1] * indices.shape[2],
        lambda camera, view, queries, canonical: field.relevancy(camera, queries, canonical, view),
    )


def dense_variant(name: str, sums: RegionSums, embeddings: Sequence[Tensor]) -> Variant:
    """Dense uplift of the embeddings, per level [R, D]; keeps N x S x D floats in memory."""
    features = weighted_means(sums, embeddings)

    def ask(camera: Camera, view: raster.Projection, queries: Tensor, canonical: Tensor) -> Tensor:
        return torch.stack([dense_relevancy(view, each, queries, canonical) for each in features])

    return Variant(name, 4.0 * len(features) * features[0].shape[1], ask)


def score_variants(
    variants: Sequence[Variant],
    gaussians: Gaussians,
    frames: Sequence[tuple[LabelledFrame, Camera]],
    vectors: dict[str, Tensor],
    canonical: Tensor,
    raster_preset: str = "inria",
    scene: str = "",
    progress: Progress = no_progress,
    preset: QueryPreset = QUERY_PRESETS["scoup"],
) -> dict[str, SceneScore]:
    """Score each variant on labelled frames with the LERF-OVS protocol; each view is projected once.

    Args:
        variants: the ways compared.
        gaussians: the scene.
        frames: labelled frames with their cameras.
        vectors: label -> [D] unit text vector.
        canonical: [P, D].
        raster_preset: as the scene was built.
        scene: its name, for the tables.
        progress: told after each frame and variant.
        preset: how maps become masks and points; the protocol's by default.

    Returns:
        Scores by the name of the variant.
    """
    total, done = len(frames) * len(variants), 0
    pairs: dict[str, list[PairScore]] = {variant.name: [] for variant in variants}
    progress("scoring", 0, total)
    for frame, camera in frames:
        view = raster.project(gaussians, camera, raster_preset)
        queries = torch.stack([vectors[label] for label in frame.labels])
        for variant in variants:
            relevancy = variant.ask(camera, view, queries, canonical)
            pairs[variant.name].extend(score_frame(frame, relevancy, preset))
            done += 1
            progress("scoring", done, total)
    return {name: SceneScore(scene, preset.name, tuple(of_name)) for name, of_name in pairs.items()}
