"""Fields that earlier code has written are read, and answer as that code did (tests/frozen_versions.py)."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors import safe_open

import frozen_versions
from cli_support import run
from frozen_versions import VERSIONS, gaussians_of_versions
from scoup.base.errors import FileFormatError
from scoup.field.artefact import METADATA_KEY, READERS
from scoup.field.language_field import LanguageField

BEFORE_VERSION_1 = "570ca70"
FIELDS = sorted(VERSIONS.glob("*/*.scoup"))
ROUNDED_OTHERWISE = {"ffa0452/field_8_bits.scoup": 1e-2}
"""Its writer rounded weights of 8 bits to 255ths of 1, and read them without dividing by their sum."""


def named(path: Path) -> str:
    return f"{path.parent.name}/{path.name}"


def header(path: Path) -> dict:
    with safe_open(path, framework="pt") as stream:
        return json.loads(stream.metadata()[METADATA_KEY])


READ = [path for path in FIELDS if path.parent.name != BEFORE_VERSION_1]


@pytest.mark.parametrize("path", READ, ids=named)
def test_it_answers_as_it_did(path: Path) -> None:
    field, kept = LanguageField.load(path), np.load(path.with_suffix(".npz"))
    if path.name == "field.scoup":
        assert field.has_geometry
    vectors = torch.from_numpy(kept["vectors"])
    seen = field.relevancy(0, vectors[:2], vectors[2:])[..., ::4, ::4].numpy()
    own = field.gaussian_relevancy(vectors[:2], vectors[2:]).numpy()
    allowed = ROUNDED_OTHERWISE.get(named(path), 1e-5)
    assert np.abs(seen - kept["relevancy"]).max() < allowed
    assert np.abs(own - kept["gaussian_relevancy"]).max() < allowed
    assert kept["relevancy"].std() > 0.1  # there is something to be compared


@pytest.mark.parametrize("path", READ, ids=named)
def test_it_is_asked_by_its_words(path: Path) -> None:
    words = VERSIONS / "scene" / "words.npz"
    answer = LanguageField.load(path, gaussians_of_versions()).query("kettle", "view_00.png", encoder=words)
    assert answer.heat.shape == (24, 32)


def test_there_is_a_file_of_every_version() -> None:
    assert {header(path)["version"] for path in READ} == set(READERS)
    assert all(path.stat().st_size < 50_000 for path in VERSIONS.rglob("*"))


def test_the_form_before_version_1_is_refused_in_one_sentence() -> None:
    path = VERSIONS / BEFORE_VERSION_1 / "field.scoup"
    with pytest.raises(FileFormatError) as caught:
        LanguageField.load(path)
    assert (
        str(caught.value) == f"{path}: is of a form from before version 1, which is not read; build it again"
    )
    code, _, error = run("info", path)
    assert (code, error.splitlines()) == (2, [f"error: {caught.value}"])


@pytest.fixture(scope="module")
def made_now(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the present code writes."""
    folder = tmp_path_factory.mktemp("versions") / "now"
    frozen_versions.main(folder)
    return folder


def form(path: Path) -> tuple[set[str], dict[str, tuple[str, int]]]:
    """What a field's file consists of: keys of the header; type and number of dimensions of every tensor."""
    with safe_open(path, framework="numpy") as stream:
        tensors = {name: stream.get_tensor(name) for name in stream.keys()}  # noqa: SIM118
    return set(header(path)), {name: (str(array.dtype), array.ndim) for name, array in tensors.items()}


@pytest.mark.parametrize("name", ["field", "field_8_bits", "kept"])
def test_what_is_written_now_has_the_form_of_its_version(made_now: Path, name: str) -> None:
    """A file of another form needs a version of its own, and its folder in tests/frozen/versions."""
    now = made_now / f"{name}.scoup"
    same = [
        path for path in READ if path.name == now.name and header(path)["version"] == header(now)["version"]
    ]
    assert same
    for path in same:
        assert form(path) == form(now)


def test_the_scene_of_the_files_is_the_one_that_is_made(made_now: Path) -> None:
    now, then = made_now.parent / "scene", VERSIONS / "scene"
    assert (now / "point_cloud.ply").read_bytes() == (then / "point_cloud.ply").read_bytes()
    with np.load(now / "words.npz") as mine, np.load(then / "words.npz") as kept:
        assert mine["names"].tolist() == kept["names"].tolist()
        assert np.array_equal(mine["vectors"], kept["vectors"])
