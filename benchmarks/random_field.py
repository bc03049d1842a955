"""A field with made-up codes over the random scene, and its words: times on it mean something, answers do not."""

from __future__ import annotations

from pathlib import Path

from scoup.field import FieldInfo
from scoup.models import CANONICAL_PHRASES, EVERYDAY_WORDS, WordTable
from scoup.query import LanguageField
from scoup.scene import Cameras, Gaussians
from scoup_lab.synthetic.random_scene import clip_like, random_scene_codes

LEVELS = ("s", "m", "l")


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


def write_words(path: Path, *more: str) -> Path:
    """Write a table with vectors of everyday words, the canonical phrases and more."""
    words = list(dict.fromkeys([*CANONICAL_PHRASES, *more, *EVERYDAY_WORDS]))
    WordTable.save(path, words, clip_like(len(words), seed=3), model="simulated")
    return path
