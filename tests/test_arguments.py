"""Arguments of public functions: numpy arrays in place of tensors give the same results; those in the wrong order or
of another kind are refused in one sentence that says which is wrong and what is expected."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

import scoup
from messages import refuses
from scoup.io import save_regions
from scoup.models import CANONICAL_PHRASES
from support import small_scene, unit

api: Any = scoup  # some calls below are wrong on purpose
gaussians, cameras, regions = cast(Any, small_scene(count=60, views=2))


@pytest.fixture(scope="module")
def field() -> scoup.LanguageField:
    return scoup.build(gaussians, cameras, regions, scoup.BuildSettings(n_atoms=8))


def test_a_field_from_arrays_is_the_same_field(field):
    names = ("means", "quats", "scales", "opacities", "sh")
    arrays = scoup.Gaussians(*(getattr(gaussians, name).double().numpy() for name in names))
    assert arrays.fingerprint() == gaussians.fingerprint()
    maps = {
        name: {
            level: scoup.RegionMap(found.labels.numpy().astype(np.int64), found.embeddings.numpy())
            for level in regions.levels
            for found in [regions.load(name, level)]
        }
        for name in regions.view_names
    }
    again = scoup.build(arrays, cameras, scoup.Regions.from_maps(maps), scoup.BuildSettings(n_atoms=8))
    assert again.code_indices.equal(field.code_indices)
    assert again.code_weights.equal(field.code_weights)
    codes = field.code_indices.numpy(), field.code_weights.numpy(), field.codebook.numpy()
    copy = scoup.LanguageField(*codes, field.info, gaussians)
    queries, canonical = unit(torch.randn(2, 16)), unit(torch.randn(4, 16))
    expected = field.gaussian_relevancy(queries, canonical)
    assert copy.gaussian_relevancy(queries.numpy(), canonical.numpy()).equal(expected)
    found = copy.relevancy(cameras[0], queries.numpy(), canonical.numpy())
    assert found.equal(field.relevancy(cameras[0], queries, canonical))
    phrases = {str(name): row for name, row in zip(CANONICAL_PHRASES, canonical.numpy(), strict=True)}
    questions = [field.with_encoder(phrases).question(each) for each in (queries.numpy(), queries)]
    mask, same = (field.select(question).mask for question in questions)
    assert mask.equal(same)
    assert len(field[mask.numpy()]) == int(mask.sum())
    seen, same = (field.at(cameras[0]).answer(question) for question in questions)
    assert all(one.mask.equal(other.mask) for one, other in zip(seen, same, strict=True))


def test_codes_from_arrays_are_the_same_codes():
    sums = scoup.region_sums(gaussians, cameras, regions)
    books = [scoup.fit_codes(regions.embeddings(level)[0], 8) for level in regions.levels]
    arrays = [scoup.fit_codes(regions.embeddings(level)[0].numpy(), 8) for level in regions.levels]
    codebook = torch.stack([book.atoms for book in books])
    assert all(one.atoms.equal(other.atoms) for one, other in zip(books, arrays, strict=True))
    pairs = [(book.codes.indices.numpy(), book.codes.weights.numpy()) for book in books]
    codes = [api.SparseCodes(*pair, 8) for pair in pairs]
    found = scoup.vote(sums, codes, codebook.numpy(), rounds=2)
    expected = scoup.vote(sums, [book.codes for book in books], codebook, rounds=2)
    assert found.indices.equal(expected.indices)
    assert found.weights.equal(expected.weights)


def test_a_camera_from_arrays_is_the_same_camera():
    camera = cameras[0]
    K, viewmat = camera.K.numpy(), camera.viewmat.numpy()
    assert scoup.Camera("a.png", viewmat, K, 40, 30).viewmat.equal(camera.viewmat)
    again = scoup.Camera.from_c2w("a.png", np.linalg.inv(viewmat), K, 40, 30)
    assert torch.allclose(again.viewmat, camera.viewmat)


# ---- in the wrong order, or of another kind


@pytest.fixture(scope="module")
def things(field: scoup.LanguageField, tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    folder, names = tmp_path_factory.mktemp("things"), ["kettle", *CANONICAL_PHRASES]
    field.save(folder / "f.scoup")
    save_regions(regions, folder / "language_features")
    asked = field.with_encoder(dict(zip(names, torch.eye(len(names), 16).numpy(), strict=True)))
    return SimpleNamespace(
        gaussians=gaussians, cameras=cameras, regions=regions, field=asked, texts=asked.question("kettle"),
        path=str(folder),
    )  # fmt: skip


SWAPPED: list[Callable[[Any], Any]] = [
    lambda t: api.build(t.cameras, t.gaussians, t.regions), lambda t: api.build(t.gaussians, t.regions, t.cameras),
    lambda t: api.build(t.gaussians, t.cameras, t.path), lambda t: api.build(t.gaussians, t.cameras, t.regions, 3),
    lambda t: api.region_sums(t.cameras, t.gaussians, t.regions),
    lambda t: api.region_sums(t.gaussians, t.path, t.regions),
    lambda t: api.LanguageField.load(t.path + "/f.scoup", t.path), lambda t: api.LanguageField.load(t.gaussians),
    lambda t: t.field.attach(t.path), lambda t: api.load_gaussians(t.gaussians), lambda t: api.load_cameras(None),
    lambda t: api.load_regions(t.cameras, t.path), lambda t: api.load_regions(t.path, t.path),
    lambda t: api.load_regions(t.path, t.gaussians), lambda t: api.load_regions(t.path, ["view_00.png"]),
    lambda t: api.save_gaussians("a.ply", t.gaussians), lambda t: t.field.at(t.cameras).answer("kettle"),
    lambda t: t.field.project(t.gaussians), lambda t: t.field.answer(t.cameras[0]),
    lambda t: t.field.select(t.path, t.texts), lambda t: t.field.select(t.gaussians.opacities > 0.5),
    lambda t: api.project(t.cameras[0], t.gaussians), lambda t: api.project(t.gaussians, t.cameras),
]  # fmt: skip


def test_the_argument_is_named(things: SimpleNamespace) -> None:
    for call in SWAPPED:
        with refuses(scoup.ScoupError):
            call(things)


def test_what_else_is_taken(things: SimpleNamespace) -> None:
    assert len(scoup.load_regions(things.path, (camera for camera in things.cameras))) == 2
    assert len(scoup.LanguageField.load(things.path + "/f.scoup", things.gaussians).gaussians) == 60
