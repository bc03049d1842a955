"""Numpy arrays in the place of tensors: the same results from every public function that takes tensors."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch

import scoup
from scoup.models import CANONICAL_PHRASES
from support import small_scene, unit

gaussians, cameras, regions = cast(Any, small_scene(count=60, views=2))


def test_a_field_from_arrays_is_the_same_field():
    field = scoup.build(gaussians, cameras, regions, scoup.BuildSettings(n_atoms=8))
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
    codes = [scoup.SparseCodes(*pair, 8) for pair in pairs]  # pyright: ignore[reportArgumentType]
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
