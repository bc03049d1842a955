"""Faults put into region sums: what changes, what does not, and that draws repeat."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from benchmarks.faults import (
    LevelSums,
    as_region_sums,
    diffuse_noise,
    level_sums,
    missing_masks,
    perturbed,
    wrong_embeddings,
)
from scipy.sparse import csr_array

from scoup.base.errors import UnknownNameError
from scoup.uplift.rasterise import region_sums
from support import small_scene, unit


def draws() -> np.random.Generator:
    return np.random.default_rng(5)


def random_level(count: int = 400, dim: int = 64, n_gaussians: int = 30) -> LevelSums:
    generator = torch.Generator().manual_seed(0)
    matrix = np.random.default_rng(0).random((n_gaussians, count), dtype=np.float32)
    rows = unit(torch.randn(count, dim, generator=generator))
    return LevelSums(csr_array(matrix), rows, np.arange(count) % 8)


def same(first: LevelSums, second: LevelSums) -> bool:
    return (
        first.embeddings.equal(second.embeddings)
        and np.array_equal(first.views, second.views)
        and np.array_equal(first.matrix.toarray(), second.matrix.toarray())
    )


def test_sums_of_a_scene() -> None:
    gaussians, cameras, regions = small_scene()
    sums = region_sums(gaussians, cameras, regions)
    levels = level_sums(sums, regions)
    for position, (level, name) in enumerate(zip(levels, regions.levels, strict=True)):
        rows, of_views = regions.embeddings(name)
        torch.testing.assert_close(level.embeddings, rows)
        assert all((level.views[part] == number).all() for number, part in enumerate(of_views.values()))
        assert level.n_gaussians == len(gaussians)
        assert np.array_equal(level.matrix.toarray(), sums.matrix(position).toarray())


@pytest.mark.parametrize("case", ["clean", "missing40", "missing95"])
def test_region_sums_and_back(case: str) -> None:
    gaussians, cameras, regions = small_scene()
    levels = perturbed(level_sums(region_sums(gaussians, cameras, regions), regions), case)
    sums = as_region_sums(levels)
    assert sums.n_gaussians == len(gaussians)
    assert sums.rows is not None
    for position, level in enumerate(levels):
        count = len(level.embeddings)
        assert np.array_equal(sums.matrix(position).toarray()[:, :count], level.matrix.toarray())
        for number, part in enumerate(sums.rows[position].values()):
            assert (level.views[part] == number).all()
        assert sum(part.stop - part.start for part in sums.rows[position].values()) == count


def test_wrong_embeddings_are_those_of_other_regions() -> None:
    level = random_level()
    found = wrong_embeddings(level, 0.2, draws())
    changed = (found.embeddings != level.embeddings).any(1)
    assert 0.15 < float(changed.float().mean()) < 0.25
    # Each is one of the old ones, and rows are taken from the old ones, not from those already wrong.
    assert ((found.embeddings[changed] @ level.embeddings.T).amax(1) > 1 - 1e-6).all()
    assert found.matrix is level.matrix
    assert (wrong_embeddings(level, 1.0, draws()).embeddings != level.embeddings).any(1).all()
    assert same(wrong_embeddings(level, 0.0, draws()), level)
    assert same(wrong_embeddings(random_level(1), 1.0, draws()), random_level(1))


@pytest.mark.parametrize("length", [0.0, 0.3, 0.6, 1.2])
def test_noise_has_the_length_asked_for(length: float) -> None:
    level = random_level(2000)
    level.embeddings[7] = 0
    found = diffuse_noise(level, length, draws()).embeddings
    assert not found[7].any()
    moved = torch.arange(2000) != 7
    assert torch.allclose(found[moved].norm(dim=1), torch.ones(1999))
    # Noise of length a at right angles to a unit vector turns it by the angle whose tangent is a.
    cosine = float((found * level.embeddings).sum(1)[moved].mean())
    assert cosine == pytest.approx(1 / np.sqrt(1 + length**2), abs=0.02)


def test_missing_masks_lose_their_column() -> None:
    level = random_level()
    found = missing_masks(level, 0.4, draws())
    count = len(found.embeddings)
    assert 0.5 < count / 400 < 0.7
    assert found.matrix.shape == (30, count)
    assert len(found.views) == count
    kept = (found.embeddings @ level.embeddings.T).argmax(1).numpy()
    assert (np.diff(kept) > 0).all()
    assert np.array_equal(found.matrix.toarray(), level.matrix.toarray()[:, kept])
    assert np.array_equal(found.views, level.views[kept])


def test_cases_repeat_and_combine() -> None:
    levels = [random_level(), random_level(300)]
    for case in ("clean", "wrong20", "noise60", "missing40", "wrong20+noise60+missing40"):
        first, second = (perturbed(levels, case, 3) for _ in range(2))
        assert all(same(a, b) for a, b in zip(first, second, strict=True)), case
        other = perturbed(levels, case, 4)
        assert (case == "clean") == all(same(a, b) for a, b in zip(first, other, strict=True)), case
    assert all(same(a, b) for a, b in zip(perturbed(levels, "clean"), levels, strict=True))
    # The same regions are wrong with noise and without.
    wrong, both = (perturbed(levels, case)[0].embeddings for case in ("wrong20", "wrong20+noise1"))
    assert (wrong * both).sum(1).min() > 0.99
    # The levels given stay as they are.
    assert same(levels[0], random_level())


@pytest.mark.parametrize("case", ["", "wrong", "20", "wrong20+", "wrong-5", "wrong2.5", "blur20", "clean20"])
def test_cases_that_are_none(case: str) -> None:
    with pytest.raises(UnknownNameError):
        perturbed([random_level()], case)
