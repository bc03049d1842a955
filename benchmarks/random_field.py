"""A field with made-up codes over the random scene, and its words: times on it mean something, answers do not."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from scoup.field import FieldInfo
from scoup.models import CANONICAL_PHRASES, EVERYDAY_WORDS, WordTable
from scoup.query import LanguageField
from scoup.scene import LEVELS, Cameras, Gaussians
from scoup_lab.synthetic.random_scene import clip_like, random_scene_codes


def random_field(
    gaussians: Gaussians,
    n_atoms: int = 128,
    k: int = 4,
    cameras: Cameras | None = None,
    words: Path | None = None,
    geometry: Path | None = None,
) -> LanguageField:
    """Return a field over Gaussians, with the file of its words, and that of the Gaussians unless they are embedded."""
    codes = random_scene_codes(gaussians.means, len(LEVELS), n_atoms, k)
    codebook = clip_like(len(LEVELS) * n_atoms).view(len(LEVELS), n_atoms, -1)
    info = FieldInfo(LEVELS, "simulated", gaussians.fingerprint(), len(gaussians), words=words)
    return LanguageField(*codes, codebook, info, gaussians, geometry, cameras)


def everyday_vectors(*more: str) -> dict[str, Tensor]:
    """Return made-up vectors [512] of everyday words, the canonical phrases and more."""
    words = dict.fromkeys([*CANONICAL_PHRASES, *more, *EVERYDAY_WORDS])
    return dict(zip(words, clip_like(len(words), seed=3), strict=True))


def write_words(path: Path, *more: str) -> Path:
    """Write a table of ``everyday_vectors``."""
    vectors = everyday_vectors(*more)
    WordTable.save(path, list(vectors), torch.stack(list(vectors.values())), model="simulated")
    return path
