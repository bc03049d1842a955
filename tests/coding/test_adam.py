"""The Gram-space solver against plain autograd over dense logits and D-dimensional features."""

from __future__ import annotations

import pytest
import torch
from coders import clip_like
from plain_adam import plain_adam

from scoup.coding.adam import LOGIT_SCALE, AdamSettings, solve_adam
from scoup.coding.kmeans import spherical_kmeans
from scoup.coding.products import DenseProducts, SparseProducts
from scoup.coding.slots import Slots, Step


def test_trajectory_equals_plain_autograd() -> None:
    # float64, where rounding cannot hide a wrong gradient: Adam turns even tiny ones into whole steps. A
    # learning rate above the paper's makes supports change and the slots grow within few epochs.
    rows = torch.nn.functional.normalize(clip_like(150, 24).double(), dim=1)
    atoms = spherical_kmeans(rows, 20, seed=0)
    settings = AdamSettings(epochs=60, learning_rate=0.02)
    solution = solve_adam(rows, 20, 3, settings=settings, initial_atoms=atoms)
    logits = rows @ torch.nn.functional.normalize(atoms, dim=1).T * LOGIT_SCALE
    plain_atoms, plain_logits, losses = plain_adam(rows, atoms, logits, 3, 60, 0.02)
    torch.testing.assert_close(solution.atoms, plain_atoms, atol=1e-8, rtol=0)
    assert solution.losses == pytest.approx(losses, abs=1e-10)
    started = logits.topk(3, dim=1).indices.sort(1).values
    values, indices = plain_logits.topk(3, dim=1)
    assert not started.equal(indices.sort(1).values), "no support changed: the test would prove little"
    assert solution.codes.indices.long().equal(indices)
    torch.testing.assert_close(solution.codes.weights, torch.softmax(values, 1).float(), atol=1e-6, rtol=0)


def test_float32_at_the_papers_settings_follows_plain_autograd() -> None:
    rows = clip_like(400, 64)
    atoms = spherical_kmeans(rows, 32, seed=0)
    solution = solve_adam(rows, 32, 4, settings=AdamSettings(epochs=50), initial_atoms=atoms)
    logits = rows @ atoms.T * LOGIT_SCALE
    _, _, losses = plain_adam(rows, atoms, logits, 4, 50, 7e-4)
    assert solution.losses == pytest.approx(losses, abs=2e-6)
    assert solution.losses[-1] < solution.losses[0]


def test_stops_when_the_loss_stalls_and_only_then() -> None:
    rows = clip_like(40, 16)
    full = solve_adam(rows, 8, 2, settings=AdamSettings(epochs=400))
    early = solve_adam(rows, 8, 2, settings=AdamSettings(epochs=400, tolerance=0.01))
    assert full.epochs == 400
    assert 100 <= early.epochs < 400
    assert early.losses[-101] - early.losses[-1] < 0.01
    assert early.losses == full.losses[: len(early.losses)]
    never = solve_adam(rows, 8, 2, settings=AdamSettings(epochs=150, tolerance=-1.0))
    assert never.epochs == 150


def test_slots_keep_what_dense_adam_would_hold() -> None:
    generator = torch.Generator().manual_seed(0)
    start = torch.randn(50, 40, generator=generator, dtype=torch.float64)
    slots = Slots(start, 3)
    dense = start.clone().requires_grad_()
    optimizer = torch.optim.Adam([dense], lr=0.05)
    for epoch in range(1, 81):
        support = dense.detach().topk(3, dim=1).indices
        gradient = torch.randn(50, 40, generator=generator, dtype=torch.float64)
        dense.grad = torch.zeros_like(dense).scatter(1, support, gradient.gather(1, support))
        atoms, places = slots.support.T.sort(1)
        assert atoms.equal(support.sort(1).values)
        weights = torch.softmax(dense.detach().gather(1, atoms), 1)
        torch.testing.assert_close(slots.weights().T.gather(1, places), weights, atol=1e-12, rtol=0)
        slots.step(gradient.T.gather(0, slots.support), Step.of_epoch(epoch, 0.05), flush=epoch % 8 == 0)
        slots.settle()
        optimizer.step()


def test_sparse_and_dense_products_agree_with_definitions() -> None:
    generator = torch.Generator().manual_seed(0)
    count, n_atoms, k, dim = 2500, 9, 3, 6  # more than two blocks of rows, the last one partial
    rows = torch.randn(count, dim, generator=generator)
    atoms = torch.randn(n_atoms, dim, generator=generator)
    support = torch.rand(n_atoms, count, generator=generator).argsort(0)[:k]
    weights, scale = torch.rand(k, count, generator=generator), torch.rand(count, generator=generator)
    dense = torch.zeros(n_atoms, count).scatter_(0, support, weights)
    for products in (SparseProducts(rows, n_atoms), DenseProducts(rows, n_atoms)):
        products.set_support(support)
        torch.testing.assert_close(products.similarities(atoms), (atoms @ rows.T).gather(0, support))
        torch.testing.assert_close(products.pull(weights), dense @ rows, atol=1e-4, rtol=1e-5)
        torch.testing.assert_close(
            products.moments(weights, scale), (dense * scale) @ dense.T, atol=1e-3, rtol=1e-5
        )
        gram = products.gram_on_support(atoms @ atoms.T)
        row = atoms[support[:, 1234]]
        torch.testing.assert_close(gram[:, :, 1234], row @ row.T)
