"""The facts of a field's file, read without torch: those of the loaded field, with the same refusals."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from torch import Tensor

from field.conftest import field_with_things
from field_files import parts_of, write_whole
from messages import check_message
from scoup.base import ScoupError
from scoup.field.checks import LEAST_GAUSSIANS, TENSORS
from scoup.field.facts import doubt_of, read_facts
from scoup.field.thing_table import NO_THING, ThingTable
from scoup.query import LanguageField
from support import altered, examples

ODD = (float("nan"), float("inf"), -1.0, 0.0, 7.0, 255.0, 65534.0)


@pytest.fixture(scope="module", params=[8, 16])
def path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A file without its Gaussians."""
    path = tmp_path_factory.mktemp("facts") / "f.scoup"
    field = altered(field_with_things(), gaussians=None)
    field.geometry_path = Path("gaussians.ply").absolute()
    field.save(path, weight_bits=request.param)
    return path


def facts_of(field: LanguageField) -> dict[str, Any]:
    """The facts of a loaded field that do not depend on its file."""
    table = field.thing_table
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
        "things": 0 if table is None else int((table.sums(torch.ones(len(field))) >= LEAST_GAUSSIANS).sum()),
        **({} if table is None else of_the_largest(table)),
        "geometry": "embedded" if field.has_geometry else geometry,
        "fingerprint": field.fingerprint,
        "provenance": field.info.provenance,
    }


def of_the_largest(table: ThingTable) -> dict[str, Any]:
    counts, level = table.sums(torch.ones(len(table.owners))), table.levels.long()
    wholes = torch.zeros(table.owners.shape[1], dtype=counts.dtype).index_add(0, level, counts)
    share = max((counts / wholes[level].clamp(min=1)).tolist(), default=0.0)
    doubt = doubt_of(table.owners.numpy(), table.levels.numpy())
    return {"largest_thing": pytest.approx(share, abs=1e-3), **({"doubt": doubt} if doubt else {})}


@pytest.mark.parametrize(("owners", "doubt"), [
    ([[0, 3], [1, 4], [2, 5]], ""),
    ([[0, 3], [1, 3], [2, NO_THING]], "a thing has 100% of the Gaussians of its level: answers may be poor"),
    ([[0, 3], [0, 4], [1, 5], [2, 3], [2, 4]], "a thing has 40% of the Gaussians of its level: answers may be poor"),
    ([[NO_THING, NO_THING]], ""),
])  # fmt: skip
def test_a_huge_thing_is_a_reason_to_doubt(owners: list[list[int]], doubt: str) -> None:
    levels = np.array([0, 0, 0, 1, 1, 1], np.uint8)
    assert doubt_of(np.array(owners, np.int32), levels) == doubt
    stored = np.array(owners, np.int32).astype(np.uint16)  # as in a file
    assert doubt_of(stored, levels) == doubt


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


def refusal(path: Path, header: dict[str, Any], tensors: dict[str, Tensor]) -> str:
    """What both readers say of a file, whose checksums are right."""
    write_whole(path, header, tensors)
    message = facts_or_refusal(path, with_torch=False)
    assert isinstance(message, str)
    assert message == facts_or_refusal(path, with_torch=True)
    return message


CHANGES: dict[str, Callable[[Tensor], Tensor | None]] = {
    "missing": lambda tensor: None,
    "shorter": lambda tensor: tensor[:-1].contiguous(),
    "another axis": lambda tensor: tensor[None],
    "a number": lambda tensor: tensor.flatten()[0].clone(),
    "another type": lambda tensor: tensor.float() if tensor.dtype == torch.float64 else tensor.double(),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
@pytest.mark.parametrize("name", TENSORS)
def test_tensors_of_another_form_are_refused(
    whole: Path, tmp_path: Path, name: str, change: Callable[[Tensor], Tensor | None]
) -> None:
    header, tensors = parts_of(whole)
    changed = change(tensors.pop(name))
    if changed is not None:
        tensors[name] = changed
    said = refusal(tmp_path / "d.scoup", header, tensors)
    assert f"{tmp_path}/d.scoup: is not a complete language field" in said


@pytest.mark.parametrize("frame", [None, [1], {"metres_per_unit": -1}, {"up": [0, 0]}, {"origin": "here"}])
def test_a_damaged_frame_is_refused(whole: Path, tmp_path: Path, frame: Any) -> None:
    header, tensors = parts_of(whole)
    check_message(refusal(tmp_path / "d.scoup", {**header, "frame": frame}, tensors))


@pytest.mark.parametrize(("name", "value"), [
    ("code_indices", 4), ("code_weights", -1), ("code_weights", torch.inf), ("codebook", torch.nan),
    ("things.owners", 3), ("things.parents", 3), ("things.levels", 3), ("things.embeddings", torch.nan),
    ("things.agreement", torch.nan), ("things.mass", torch.inf), ("things.stability", torch.nan),
    ("names.rows", 2), ("names.things", 3), ("names.votes", torch.nan), ("names.presence", torch.inf),
    ("cameras.viewmats", torch.nan), ("cameras.viewmats", 7), ("cameras.Ks", -1), ("cameras.sizes", 0),
    ("geometry.means", 7), ("things.colours", None),  # unknown
])  # fmt: skip
def test_values_that_make_no_sense_are_refused(
    whole: Path, tmp_path: Path, name: str, value: float | None
) -> None:
    header, tensors = parts_of(whole)
    if value is None:
        tensors[name] = torch.zeros(3)
    else:
        tensors[name].numpy().flat[0] = value
    check_message(refusal(tmp_path / "d.scoup", header, tensors))


@st.composite
def changes(draw: st.DrawFn) -> tuple[str, str, int, Any]:
    """What is changed, how, where, and to what."""
    how = draw(st.sampled_from(["value", "value", "value", "kind", "cut", "missing", "header"]))
    value = draw(
        st.sampled_from([torch.uint8, torch.float16, torch.float32, torch.int32] if how == "kind" else ODD)
    )
    header = ["levels", "cameras", "names", "geometry", "provenance", "embedding_model", "words"]
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
