"""A field with things and names, and its file."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from field_files import parts_of, small_field
from scoup.field.checks import TENSORS
from scoup.field.facts import read_facts
from scoup.field.thing_table import NO_THING, NameTable
from scoup.query import LanguageField
from support import altered, things_of, unit


def field_with_things() -> LanguageField:
    """The small field with three things, two of them named."""
    field = small_field()
    things = things_of(
        torch.arange(len(field) * 3).view(-1, 3) % 4 + NO_THING,
        torch.tensor([0, 1, 2]),
        unit(torch.randn(3, field.dim, generator=torch.Generator().manual_seed(0))),
        parents=torch.tensor([1, 2, NO_THING], dtype=torch.int32),
        agreement=torch.tensor([0.9, 0.8, 0.7]),
        n_regions=torch.tensor([3, 4, 5], dtype=torch.int32),
        names=NameTable(
            ("mug", "kettle"),
            torch.tensor([0.9, 0.1]),
            torch.tensor([0, 0], dtype=torch.int32),
            torch.tensor([1, 2], dtype=torch.int32),
            torch.tensor([0.5, 0.25]),
        ),
    )
    return altered(field, thing_table=things)


@pytest.fixture(scope="session")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its file, with all tensors that there may be; nobody changes it."""
    path = tmp_path_factory.mktemp("whole") / "f.scoup"
    field_with_things().save(path, embed_geometry=True)
    assert parts_of(path)[1].keys() == TENSORS.keys()
    assert read_facts(path)["geometry"] == "embedded"
    return path
