"""The facts of a field's file, read without torch: those of the loaded field, with the same refusals."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from safetensors import safe_open
from safetensors.torch import save_file
from torch import Tensor

from frozen_fields import small_field
from scoup.base.digests import sealed
from scoup.base.errors import ScoupError
from scoup.field.artefact import tensor_checksum
from scoup.field.container import METADATA_KEY
from scoup.field.facts import read_facts
from scoup.field.language_field import LanguageField
from scoup.scene.things import NO_THING, ThingTable
from support import examples, unit

ODD = (float("nan"), float("inf"), -1.0, 0.0, 7.0, 255.0, 65534.0)


def field_with_things() -> LanguageField:
    """The small field with three things, and without Gaussians in its file."""
    field = small_field()
    things = ThingTable(
        owners=torch.arange(len(field) * 3).view(-1, 3).int() % 4 + NO_THING,
        levels=torch.tensor([0, 1, 2], dtype=torch.uint8),
        parents=torch.tensor([1, 2, NO_THING], dtype=torch.int32),
        embeddings=unit(torch.randn(3, field.dim, generator=torch.Generator().manual_seed(0))).half(),
        agreement=torch.tensor([0.9, 0.8, 0.7]),
        n_regions=torch.tensor([3, 4, 5], dtype=torch.int32),
        mass=torch.ones(3),
        stability=torch.ones(3),
    )
    codes = field.code_indices, field.code_weights, field.codebook
    made = LanguageField(*codes, field.info, cameras=field.cameras, thing_table=things)
    made.geometry_path = Path("gaussians.ply").absolute()
    return made


@pytest.fixture(scope="module", params=[8, 16])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("facts") / "f.scoup"
    field_with_things().save(path, weight_bits=request.param)
    return path


def parts_of(path: Path) -> tuple[dict[str, Any], dict[str, Tensor]]:
    with safe_open(path, framework="pt") as stream:
        tensors = {name: stream.get_tensor(name).clone() for name in stream.keys()}  # noqa: SIM118
        return json.loads(stream.metadata()[METADATA_KEY]), tensors


def write_whole(path: Path, header: dict[str, Any], tensors: dict[str, Tensor]) -> None:
    """A file whose checksums are right, whatever it contains."""
    header = {**header, "checksums": {name: tensor_checksum(tensor) for name, tensor in tensors.items()}}
    save_file(tensors, path, {METADATA_KEY: sealed(header)})


def facts_of(field: LanguageField) -> dict[str, Any]:
    """The facts of a loaded field that do not depend on its file."""
    geometry = None if field.geometry_path is None else f"{field.geometry_path} (not there)"
    return {
        "gaussians": len(field),
        "coded": int(field.coded().sum()),
        "levels": list(field.levels),
        "atoms": field.n_atoms,
        "k": field.code_indices.shape[2],
        "dim": field.dim,
        "embedding_model": field.embedding_model,
        "words": None if field.info.words is None else f"{field.info.words} (not there)",
        "raster_preset": field.raster_preset,
        "cameras": 0 if field.cameras is None else len(field.cameras),
        "geometry": "embedded" if field.has_geometry else geometry,
        "fingerprint": field.fingerprint,
        "provenance": field.info.provenance,
    }


def facts_or_refusal(path: Path, with_torch: bool) -> dict[str, Any] | str:
    try:
        if with_torch:
            return facts_of(LanguageField.load(path))
        facts = read_facts(path)
        return {name: value for name, value in facts.items() if not name.startswith("bytes")}
    except ScoupError as error:
        return f"{type(error).__name__}: {error}"


def test_they_are_those_of_the_loaded_field(path: Path) -> None:
    facts = facts_or_refusal(path, with_torch=False)
    assert facts == facts_or_refusal(path, with_torch=True)
    assert isinstance(facts, dict)
    assert facts["cameras"] > 0
    assert facts["geometry"].endswith("gaussians.ply (not there)")
    assert read_facts(path)["bytes"] == path.stat().st_size


def test_embedded_gaussians_are_those_of_the_fingerprint(tmp_path: Path) -> None:
    field = small_field()
    field.geometry_path = None
    path = tmp_path / "f.scoup"
    field.save(path, embed_geometry=True)
    assert read_facts(path)["geometry"] == "embedded"
    header, tensors = parts_of(path)
    tensors["geometry.means"][0, 0] += 1
    write_whole(path, header, tensors)
    refusal = facts_or_refusal(path, with_torch=False)
    assert "its Gaussians have another fingerprint than its header" in refusal
    assert refusal == facts_or_refusal(path, with_torch=True)


@st.composite
def changes(draw: st.DrawFn) -> tuple[str, str, int, Any]:
    """What is changed, how, where, and to what."""
    how = draw(st.sampled_from(["value", "value", "value", "kind", "cut", "missing", "header"]))
    value = draw(
        st.sampled_from([torch.uint8, torch.float16, torch.float32, torch.int32] if how == "kind" else ODD)
    )
    header = ["levels", "cameras", "geometry", "provenance", "embedding_model", "words"]
    what = draw(st.sampled_from(header)) if how == "header" else ""
    return how, what, draw(st.integers(0, 10_000)), value


@settings(
    max_examples=examples(150), suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
@given(changes())
def test_both_refuse_the_same_damage_alike(path: Path, change: tuple[str, str, int, Any]) -> None:
    how, what, place, value = change
    header, tensors = parts_of(path)
    name = sorted(tensors)[place % len(tensors)]
    tensor = tensors[name]
    if how == "value":
        whole = int(value) if 0 <= value < 1e9 else 9
        number = value if tensor.is_floating_point() else min(whole, torch.iinfo(tensor.dtype).max)
        flat = tensor.flatten().double()
        flat[place % flat.numel()] = number
        tensors[name] = flat.to(tensor.dtype).view(tensor.shape)
    elif how == "kind":
        tensors[name] = tensor.double().to(value)
    elif how == "cut":
        tensors[name] = tensor[..., :-1].contiguous() if place % 2 else tensor[:-1].contiguous()
    elif how == "missing":
        del tensors[name]
    elif place % 3 == 0:
        header[what] = None
    elif isinstance(header[what], list):
        header[what] = header[what][:-1] if place % 3 == 1 else header[what][:1] * len(header[what])
    else:
        header[what] = {}
    changed = path.with_name("changed.scoup")
    write_whole(changed, header, tensors)
    assert facts_or_refusal(changed, with_torch=False) == facts_or_refusal(changed, with_torch=True)
