"""Consensus before coding: against the definition written with dense matrices, and what it is for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.sparse import coo_array, csr_array
from torch import Tensor

from scoup.base.errors import InputError
from scoup.raster import ViewSums
from scoup.uplift import consensus as module
from scoup.uplift.consensus import ConsensusSettings, consensus, consensus_of, covisible
from scoup.uplift.region_sums import RegionSums

EXACT = ConsensusSettings(least=0.0, most=10_000)


def random_sums(n: int, r: int, seed: int, density: float = 0.3) -> csr_array:
    rng = np.random.default_rng(seed)
    dense = rng.random((n, r)) * (rng.random((n, r)) < density)
    return csr_array(dense.astype(np.float32))


def random_rows(r: int, seed: int, dim: int = 16) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.nn.functional.normalize(torch.randn(r, dim, generator=generator) + 0.7, dim=1)


def dense_shares(matrix: csr_array) -> np.ndarray:
    """M by its definition, float64."""
    a = matrix.toarray().astype(np.float64)
    z = a.sum(1)
    m = a.T @ np.diag(np.where(z > 0, 1 / np.where(z > 0, z, 1), 0)) @ a
    total = m.sum(1, keepdims=True)
    return np.divide(m, total, out=np.zeros_like(m), where=total > 0)


def dense_consensus(matrix: csr_array, rows: Tensor, settings: ConsensusSettings) -> np.ndarray:
    """The definition as loops over regions, float64, without a bound on the entries of a row."""
    f = rows.double().numpy()
    norm = np.linalg.norm(f, axis=1, keepdims=True)
    f = np.divide(f, norm, out=np.zeros_like(f), where=norm > 0)
    m = dense_shares(matrix)
    m[m < settings.least] = 0
    count = len(f)
    pairs = [
        1 - f[r] @ f[s]
        for r in range(count)
        for s in range(count)
        if r != s and m[r, s] > 0 and norm[r] > 0 and norm[s] > 0
    ]
    # torch's median is the lower of the two in the middle
    middle = sorted(pairs)[(len(pairs) - 1) // 2] if pairs else 0.0
    kappa = settings.strictness / max(middle, module.LEAST_DISTANCE)
    g = f.copy()
    for _ in range(settings.rounds):
        new = g.copy()
        for r in range(count):
            if norm[r] > 0 and m[r].any():
                total = sum(m[r, s] * np.exp(-kappa * (1 - f[s] @ g[r])) * f[s] for s in range(count))
                new[r] = total / np.linalg.norm(total)
        g = new
    return g


def test_covisible_is_its_definition() -> None:
    matrix = random_sums(60, 17, 0)
    found = covisible(matrix, EXACT)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found.toarray(), dense_shares(matrix), atol=1e-6)
    np.testing.assert_allclose(found.sum(1), 1, atol=1e-6)
    for row in range(17):
        columns = found.indices[found.indptr[row] : found.indptr[row + 1]]
        assert (np.diff(columns) > 0).all()


@given(st.integers(1, 40), st.integers(1, 14), st.integers(0, 10_000), st.sampled_from([0.05, 0.3, 1.0]))
def test_agrees_with_the_dense_definition(n: int, r: int, seed: int, density: float) -> None:
    matrix, rows = random_sums(n, r, seed, density), random_rows(r, seed)
    if seed % 3 == 0:
        rows[seed % r] = 0
    found = consensus_of(matrix, rows, EXACT)
    assert found.dtype == torch.float32
    np.testing.assert_allclose(found.numpy(), dense_consensus(matrix, rows, EXACT), atol=2e-4)


def test_small_shares_do_not_count() -> None:
    settings = ConsensusSettings(least=0.06, most=10_000)
    matrix, rows = random_sums(80, 15, 3), random_rows(15, 3)
    assert covisible(matrix, settings).nnz < covisible(matrix, EXACT).nnz
    np.testing.assert_allclose(
        consensus_of(matrix, rows, settings).numpy(), dense_consensus(matrix, rows, settings), atol=2e-4
    )


def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    matrix, rows = random_sums(200, 40, 1), random_rows(40, 1)
    whole = consensus_of(matrix, rows, EXACT)
    monkeypatch.setattr(module, "BLOCK_ENTRIES", 1)
    monkeypatch.setattr(module, "SCAN", 7)
    monkeypatch.setattr(module, "REPORT_EVERY", 3)
    assert torch.equal(consensus_of(matrix, rows, EXACT), whole)


@pytest.mark.parametrize("most", [1, 3, 8])
def test_a_row_keeps_its_largest_entries(most: int) -> None:
    matrix = random_sums(100, 20, 5)
    kept = covisible(matrix, ConsensusSettings(least=0.0, most=most))
    assert (np.diff(kept.indptr) == most).all()
    dense = dense_shares(matrix)
    largest = np.sort(dense, axis=1)[:, ::-1][:, :most]
    np.testing.assert_allclose(np.sort(kept.toarray(), axis=1)[:, ::-1][:, :most], largest, atol=1e-6)


def test_of_equal_entries_the_first_stay() -> None:
    matrix = csr_array(np.ones((4, 6), np.float32))
    kept = covisible(matrix, ConsensusSettings(least=0.0, most=2))
    assert kept.indices.reshape(6, 2).tolist() == [[0, 1]] * 6


def test_result_is_of_unit_norm_and_the_input_stays() -> None:
    matrix, rows = random_sums(50, 12, 2), 3 * random_rows(12, 2)
    before, data = rows.clone(), matrix.data.copy()
    found = consensus_of(matrix, rows)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(12))
    assert torch.equal(rows, before)
    assert (matrix.data == data).all()


def test_regions_in_another_order_give_the_same_in_that_order() -> None:
    matrix, rows = random_sums(90, 25, 7), random_rows(25, 7)
    order = np.random.default_rng(0).permutation(25)
    there = consensus_of(csr_array(matrix.toarray()[:, order]), rows[torch.from_numpy(order)])
    torch.testing.assert_close(there, consensus_of(matrix, rows)[torch.from_numpy(order)], atol=2e-5, rtol=0)


def two_objects(shared: float, views: int = 24, dim: int = 64) -> tuple[csr_array, Tensor, Tensor]:
    """Two objects of different size seen in every view; Gaussians at their border are painted by both.

    Returns:
        A [N, 2 views], embeddings [2 views, D] with noise, and the truth; region 2 v + o is object o in view v.
    """
    rng = np.random.default_rng(4)
    inner = [200, 20]  # Gaussians of the one and the other
    a = np.zeros((sum(inner) + 60, 2 * views), np.float32)
    for v in range(views):
        a[: inner[0], 2 * v] = rng.random(inner[0])
        a[inner[0] : sum(inner), 2 * v + 1] = rng.random(inner[1])
        a[sum(inner) :, 2 * v] = rng.random(60)
        a[sum(inner) :, 2 * v + 1] = shared * rng.random(60)
    generator = torch.Generator().manual_seed(0)
    common = torch.randn(dim, generator=generator)  # as of CLIP: embeddings lie in a cone
    truth = torch.nn.functional.normalize(torch.randn(2, dim, generator=generator) + common, dim=1)
    truth = truth.repeat(views, 1)
    noise = 0.4 * torch.randn(2 * views, dim, generator=generator) / dim**0.5
    return csr_array(a), torch.nn.functional.normalize(truth + noise, dim=1), truth


def test_a_wrong_embedding_is_mended() -> None:
    matrix, rows, truth = two_objects(shared=0.2)
    swapped = rows.clone()
    swapped[4] = rows[5]  # object 0 in view 2 is called object 1
    assert float(swapped[4] @ truth[4]) < 0.7
    found = consensus_of(matrix, swapped)
    cosines = (found * truth).sum(1)
    assert float(cosines[4]) > 0.9
    assert float(cosines.min()) > float((rows * truth).sum(1).min())


def test_border_gaussians_do_not_blend_objects() -> None:
    matrix, rows, truth = two_objects(shared=1.0)
    adaptive = consensus_of(matrix, rows)
    plain = consensus_of(matrix, rows, ConsensusSettings(strictness=0.0))
    small = slice(1, None, 2)

    def own(found: Tensor) -> float:
        return float((found * truth).sum(1)[small].mean())

    assert own(plain) < 0.96  # the small object drowns in the large one
    assert own(adaptive) > 0.99
    assert own(adaptive) > own(rows)


def test_strictness_zero_is_the_plain_mean() -> None:
    matrix, rows = random_sums(60, 12, 9), random_rows(12, 9)
    plain = torch.nn.functional.normalize(torch.from_numpy(dense_shares(matrix)).float() @ rows, dim=1)
    found = consensus_of(matrix, rows, ConsensusSettings(strictness=0.0, least=0.0))
    torch.testing.assert_close(found, plain, atol=1e-5, rtol=0)


def test_regions_that_nothing_painted_keep_their_embedding() -> None:
    dense = random_sums(50, 10, 1).toarray()
    dense[:, [2, 9]] = 0
    rows = random_rows(10, 1)
    found = consensus_of(csr_array(dense), 2 * rows)
    torch.testing.assert_close(found[[2, 9]], rows[[2, 9]])
    rest = [0, 1, 3, 4, 5, 6, 7, 8]
    torch.testing.assert_close(
        found[rest], consensus_of(csr_array(dense[:, rest]), rows[rest]), atol=1e-5, rtol=0
    )


def test_explicit_zeros_count_as_nothing() -> None:
    matrix = csr_array((np.zeros(2, np.float32), np.array([0, 1]), np.array([0, 2])), shape=(1, 2))
    rows = random_rows(2, 0)
    torch.testing.assert_close(consensus_of(matrix, rows), rows)


def test_zero_embeddings_stay_zero_and_reach_no_other() -> None:
    matrix, rows = random_sums(60, 10, 6), random_rows(10, 6)
    rows[3] = 0
    found = consensus_of(matrix, rows, EXACT)
    assert not found[3].any()
    torch.testing.assert_close(
        found, torch.from_numpy(dense_consensus(matrix, rows, EXACT)).float(), atol=2e-4, rtol=0
    )
    assert not consensus_of(matrix, torch.zeros(10, 16)).any()


def test_one_region_and_none() -> None:
    rows = random_rows(1, 0)
    torch.testing.assert_close(consensus_of(random_sums(20, 1, 0, 1.0), rows), rows)
    assert consensus_of(csr_array((20, 0), dtype=np.float32), torch.zeros(0, 16)).shape == (0, 16)
    torch.testing.assert_close(consensus_of(csr_array((0, 1), dtype=np.float32), rows), rows)


def test_equal_embeddings_stay() -> None:
    rows = random_rows(1, 0).repeat(8, 1)
    torch.testing.assert_close(consensus_of(random_sums(30, 8, 0), rows), rows)


def test_a_region_far_from_all_others_gets_a_unit_row() -> None:
    # Weights so far apart that exp underflows without care: all but one embedding are nearly equal.
    rows = random_rows(1, 0).repeat(30, 1) + 1e-3 * random_rows(30, 1)
    rows[0] = -rows[1]
    found = consensus_of(csr_array(np.ones((5, 30), np.float32)), rows)
    torch.testing.assert_close(found.norm(dim=1), torch.ones(30))


def test_same_bits_for_any_number_of_threads() -> None:
    matrix, rows = random_sums(3000, 300, 8, 0.05), random_rows(300, 8, 512)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 2, 2):
            torch.set_num_threads(threads)
            found.append(consensus_of(matrix, rows))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert torch.equal(found[0], found[1])
    assert torch.equal(found[1], found[2])


def sums_of_views(seed: int = 0) -> tuple[RegionSums, list[Tensor]]:
    """Two levels, three views of which one shows nothing at the second level; rows in no order."""
    rng = np.random.default_rng(seed)
    n, stride = 40, 6
    counts = {"a": (6, 3), "b": (4, 0), "c": (5, 2)}
    rows, start = [{}, {}], [0, 0]
    sums = RegionSums("", torch.from_numpy(rng.permutation(n)), ("s", "m"))
    for name, count in counts.items():
        keys = []
        for level in (0, 1):
            rows[level][name] = slice(start[level], start[level] + count[level])
            start[level] += count[level]
            keys.append(level * stride + np.arange(count[level]))
        gaussian, key = np.meshgrid(np.arange(n), np.concatenate(keys))
        chosen = rng.permutation(gaussian.size)[: gaussian.size // 3]
        level, region = np.divmod(key.ravel()[chosen], stride)
        weight = rng.random(len(chosen)).astype(np.float32)
        parts = [torch.from_numpy(part) for part in (gaussian.ravel()[chosen], level, region, weight)]
        sums.append(name, ViewSums.of_triplets(parts[0], parts[1], parts[2], parts[3], 2))
    sums.rows = rows
    return sums, [random_rows(total, seed) for total in start]


def all_at_once(sums: RegionSums, level: int) -> csr_array:
    """The matrix from all triplets together, by scipy."""
    gaussians, regions, weights = [], [], []
    assert sums.rows is not None
    for name in sums.views:
        gaussian, region, weight = sums.triplets(name, level)
        gaussians.append(gaussian)
        regions.append(region + sums.rows[level][name].start)
        weights.append(weight)
    total = max(rows.stop for rows in sums.rows[level].values())
    parts = np.concatenate(weights), (np.concatenate(gaussians), np.concatenate(regions))
    return coo_array(parts, shape=(sums.n_gaussians, total)).tocsr()


def test_sums_stacked_view_by_view_are_the_matrix() -> None:
    sums, _ = sums_of_views()
    for level in (0, 1):
        stacked, matrix = sums.matrix(level), all_at_once(sums, level)
        assert stacked.dtype == np.float32
        assert stacked.shape == matrix.shape
        assert stacked.nnz == matrix.nnz
        assert (stacked.indptr == matrix.indptr).all()
        matrix.sort_indices()
        assert (stacked.indices == matrix.indices).all()
        assert (stacked.data == matrix.data).all()


def test_consensus_of_all_levels_tells_how_far_it_is() -> None:
    sums, embeddings = sums_of_views()
    calls: list[tuple[str, int, int]] = []
    found = consensus(sums, embeddings, progress=lambda *call: calls.append(call))
    for level, rows in enumerate(embeddings):
        torch.testing.assert_close(found[level], consensus_of(sums.matrix(level), rows))
    total = 4 * sum(map(len, embeddings))
    assert calls[0] == (module.STAGE, 0, total)
    assert calls[-1] == (module.STAGE, total, total)
    assert [done for _, done, _ in calls] == sorted(done for _, done, _ in calls)


def test_it_can_be_interrupted() -> None:
    class StopError(Exception):
        pass

    def stop(stage: str, done: int, total: int) -> None:
        if done:
            raise StopError

    threads = torch.get_num_threads()
    with pytest.raises(StopError):
        consensus_of(random_sums(50, 10, 0), random_rows(10, 0), progress=stop)
    assert torch.get_num_threads() == threads


def test_no_rounds_leave_the_embeddings() -> None:
    rows = random_rows(10, 0)
    torch.testing.assert_close(consensus_of(random_sums(50, 10, 0), rows, ConsensusSettings(rounds=0)), rows)


def test_what_cannot_be_used_is_refused() -> None:
    matrix, rows = random_sums(50, 10, 0), random_rows(10, 0)
    with pytest.raises(InputError, match="10 regions, but there are 9"):
        consensus_of(matrix, rows[:9])
    rows[4, 2] = float("nan")
    with pytest.raises(InputError, match="not finite"):
        consensus_of(matrix, rows)
    sums, embeddings = sums_of_views()
    with pytest.raises(InputError, match="2 levels"):
        consensus(sums, embeddings[:1])
    bad: list[dict[str, Any]] = [{"rounds": -1}, {"most": 0}, {"least": 1.0}, {"strictness": -1.0}]
    for wrong in bad:
        with pytest.raises(InputError):
            ConsensusSettings(**wrong)
