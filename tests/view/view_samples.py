"""A small field with a word table, a page without a program, and what the page's files hold."""

from __future__ import annotations

import gzip
import json
from functools import cache
from typing import Any

import numpy as np
import torch
from safetensors.numpy import load
from torch import Tensor

from scoup.field import FieldInfo
from scoup.models import CANONICAL_PHRASES
from scoup.query import Answer, LanguageField
from scoup.query.ask import each_answer
from scoup.scene import Cameras, Gaussians, index_dtype
from scoup.view.page import PROGRAM, SETTINGS, STYLE, PageFiles
from scoup.view.viewed_field import ViewedField
from support import altered, make_camera, random_gaussians, things_of, unit

DIM = 12
THINGS_OF_A_LEVEL = 5
WORDS = tuple(f"thing {number}" for number in range(20))
PAGE = PageFiles(
    f"<!doctype html><head>{STYLE}{SETTINGS}</head><body>{PROGRAM}</body>",
    b"console.log('</script>')",
    "body { color: black }",
    "three: MIT -- as it is",
)


def random_field(
    count: int = 60,
    seed: int = 0,
    n_atoms: int = 9,
    k: int = 4,
    cameras: bool = True,
    kinds: tuple[str, ...] = ("plain",),
) -> LanguageField:
    """A field of random codes at two levels; about a fifth of the Gaussians have none."""
    gaussians = random_gaussians(count, seed, kinds)
    generator = torch.Generator().manual_seed(seed)
    indices = torch.randint(n_atoms, (count, 2, k), generator=generator).to(index_dtype(n_atoms))
    weights = torch.rand(count, 2, k, generator=generator)
    weights *= torch.rand(count, 2, 1, generator=generator) > 0.2
    weights[..., -1] = 0
    weights = weights / weights.sum(-1, keepdim=True).clamp(min=1e-9)
    info = FieldInfo(("s", "l"), "", gaussians.fingerprint(), count)
    codebook = unit(torch.randn(2, n_atoms, DIM, generator=generator))
    views = Cameras(make_camera(seed=seed + number, name=f"view_{number}.png") for number in range(3))
    return LanguageField(indices, weights, codebook, info, gaussians, cameras=views if cameras else None)


def field_with_things(count: int = 300, agreement: float = 0.85) -> LanguageField:
    """A random field with things at two levels, some of which mean a word; some Gaussians belong to none."""
    field = random_field(count)
    generator = torch.Generator().manual_seed(9)
    levels = torch.arange(2).repeat_interleave(THINGS_OF_A_LEVEL)
    number = torch.randint(-1, THINGS_OF_A_LEVEL, (count, 2), generator=generator)
    owners = torch.where(number < 0, -1, number + torch.tensor([0, THINGS_OF_A_LEVEL]))
    vectors = torch.stack([table()[name] for name in WORDS[: len(levels)]])
    embeddings = unit(vectors + 0.1 * torch.randn(vectors.shape, generator=generator))
    parts = {
        "agreement": torch.full((len(levels),), agreement),
        "mass": torch.rand(len(levels), generator=generator) + 0.5,
    }
    return altered(field, thing_table=things_of(owners, levels, embeddings, **parts))


@cache
def table(dim: int = DIM) -> dict[str, Tensor]:
    """A word table; nobody changes it."""
    names = (*WORDS, *CANONICAL_PHRASES)
    vectors = unit(torch.randn(len(names), dim, generator=torch.Generator().manual_seed(5)))
    return dict(zip(names, vectors, strict=True))


def viewed_field(**options: Any) -> ViewedField:
    most = options.pop("most", 1000)
    words = options.pop("words", None)
    return ViewedField(random_field(**options).with_encoder(table()), words, most)


def unpacked(data: bytes) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Tensors and metadata of a packed file, as the page reads them."""
    plain = gzip.decompress(data)
    length = int.from_bytes(plain[:8], "little")
    header = json.loads(plain[8 : 8 + length])
    return load(plain), json.loads(header["__metadata__"]["scoup"])


def splat_of(tensors: dict[str, np.ndarray], metadata: dict[str, Any]) -> Gaussians:
    """The Gaussians of a page's scene, unpacked as the page does."""
    planes = tensors["means"].astype(np.float64)  # [3 bytes, 3 axes, N]
    steps = (planes * np.array([65536, 256, 1])[:, None, None]).sum(0).T
    low, high = np.array(metadata["means_low"]), np.array(metadata["means_high"])
    means = low + steps / (2**24 - 1) * (high - low)
    extent = metadata["scales_high"] - metadata["scales_low"]
    scales = np.exp(metadata["scales_low"] + tensors["scales"].T / 255 * extent)
    quats = tensors["quats"].T.astype(np.float64)
    quats /= np.linalg.norm(quats, axis=1, keepdims=True).clip(1e-9)
    colors = (tensors["colors"].T / 255 - 0.5) / 0.28209479177387814
    arrays = means, quats, scales, tensors["opacities"] / 255, colors[:, None]
    return Gaussians(*(torch.from_numpy(array.astype(np.float32)) for array in arrays))


def shown_relevancy(
    tensors: dict[str, np.ndarray],
    metadata: dict[str, Any],
    canonical: np.ndarray,
    scores: np.ndarray,
    level: int,
) -> np.ndarray:
    """[N] relevancy of the Gaussians as the page counts it."""
    weights = tensors["code_weights"][level] / 65535 * metadata["weights_scale"]  # [K, N]
    indices = tensors["code_indices"][level].astype(int)
    cosine = (weights * scores[level][indices]).sum(0)
    rivals = (weights * canonical[level][:, indices]).sum(1).max(0)
    return 1 / (1 + np.exp(-10 * (cosine - rivals)))


def selected_by_votes(
    viewed: ViewedField, text: str, level: int | None = None, threshold: float | None = None
) -> Tensor:
    """[N] what the page's shader is to select, from the field's own relevancy of its Gaussians."""
    answer, question = viewed.answers([text])[0], viewed.question([text])
    level = answer.level if level is None else level
    relevancy = viewed.field.gaussian_relevancy(question.queries, question.canonical)[level, 0]
    low, high = answer.spans[level].tolist()
    rescaled = ((relevancy - low) / max(high - low, 1e-9)).clamp(0, 1)
    own = answer.thresholds[level] if threshold is None else threshold
    return (rescaled > own) & viewed.field.coded_levels()[level]


def of_select(
    viewed: ViewedField, text: str, level: int | None = None, threshold: float | None = None
) -> Answer:
    """What `scoup select --always` answers."""
    question = viewed.question([text], always=True, threshold=threshold, level=level)
    return next(iter(each_answer(viewed.field, question)))
