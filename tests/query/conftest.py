"""A field of a small scene, built once."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from scoup.models import CANONICAL_PHRASES
from scoup.query.answer import AskedText
from scoup.query.language_field import LanguageField, build
from scoup.query.question import Question
from scoup.scene import Camera
from scoup.uplift import BuildSettings
from support import altered, small_scene, unit


def random_vectors(*shape: int, seed: int = 0) -> Tensor:
    return unit(torch.randn(*shape, generator=torch.Generator().manual_seed(seed)))


ASKED = AskedText("kettle", random_vectors(1, 16), random_vectors(4, 16, seed=1), level=0, present_from=None)


@dataclass(frozen=True, eq=False)
class Queried:
    """A field, one of its cameras, and texts to query it with; nobody changes them."""

    field: LanguageField
    camera: Camera
    texts: Question[list[str]]


@pytest.fixture(scope="session")
def queried() -> Queried:
    gaussians, cameras, regions = small_scene(count=80, views=3)
    field = build(gaussians, cameras, regions, BuildSettings(n_atoms=8))
    vectors = random_vectors(11, 16), random_vectors(3, 16, seed=1), random_vectors(30, 16, seed=2)
    return Queried(
        field, cameras[0], Question(tuple(f"word {i}" for i in range(11)), *vectors, source="words.npz")
    )


WORDS = (*CANONICAL_PHRASES, *(f"word {number}" for number in range(30)))


@pytest.fixture
def table() -> dict[str, Tensor]:
    return dict(zip(WORDS, random_vectors(len(WORDS), 16, seed=5), strict=True))


@pytest.fixture
def field(queried: Queried, table: dict[str, Tensor]) -> LanguageField:
    """A field of one's own, which takes the words of the table."""
    return queried.field.with_gaussians(queried.field.gaussians).with_encoder(table)


def without_things(field: LanguageField) -> LanguageField:
    """The same field, answered by the votes of its Gaussians alone."""
    return altered(field, thing_table=None, words=field.words)


@pytest.fixture(scope="session")
def voted(queried: Queried) -> Queried:
    """The same scene and texts, with a field that has no things."""
    return replace(queried, field=without_things(queried.field))
