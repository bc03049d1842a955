"""The Gram-space solver against plain autograd over dense logits and D-dimensional features."""

from __future__ import annotations

import pytest
import torch
from coders import clip_like
from torch import Tensor

from scoup.coding.adam import LEARNING_RATE, LOGIT_SCALE, START_ITERATIONS, solve_adam
from scoup.coding.backends import coding_backend
from scoup.coding.kmeans import spherical_kmeans


def plain_loss(rows: Tensor, atoms: Tensor, logits: Tensor, k: int) -> Tensor:
    """The paper's loss in its plain form."""
    soft = torch.softmax(logits, dim=1)
    values, indices = torch.topk(soft, k, dim=1)
    weights = torch.zeros_like(soft).scatter(1, indices, values)
    weights = weights / weights.sum(1, keepdim=True)
    return (1 - torch.nn.functional.cosine_similarity(weights @ atoms, rows, dim=1)).mean()


def test_the_papers_settings_follow_plain_autograd(backend: str) -> None:
    """The solver in its plain form: dense logits, D-dimensional reconstructions, autograd, Adam."""
    rows = clip_like(400, 64)
    solution = solve_adam(rows, 32, 4, epochs=50, backend=backend)
    random = torch.Generator().manual_seed(0)
    atoms = spherical_kmeans(rows, 32, random, coding_backend(backend), START_ITERATIONS).requires_grad_()
    start = rows @ atoms.detach().T * LOGIT_SCALE
    logits = start.clone().requires_grad_()
    optimizer = torch.optim.Adam([logits, atoms], lr=LEARNING_RATE)
    losses = []
    for _ in range(50):
        optimizer.zero_grad()
        loss = plain_loss(rows, atoms, logits, 4)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert solution.losses == pytest.approx(losses, abs=2e-6)
    assert solution.losses[-1] < solution.losses[0]
    values, indices = logits.detach().topk(4, dim=1)
    changed = (start.topk(4, dim=1).indices.sort(1).values != indices.sort(1).values).any(1)
    assert float(changed.float().mean()) > 0.05, "hardly a support changed: the test would prove little"
    same = (solution.codes.indices.long() == indices).all(1)
    assert float(same.float().mean()) > 0.98
    weights = values.softmax(1)[same]
    torch.testing.assert_close(solution.codes.weights[same], weights, atol=1e-3, rtol=0)


def test_stops_when_the_loss_stalls_and_only_then() -> None:
    rows = clip_like(40, 16)
    full = solve_adam(rows, 8, 2, epochs=400)
    early = solve_adam(rows, 8, 2, epochs=400, tolerance=0.01)
    assert full.steps == 400
    assert 100 <= early.steps < 400
    assert early.losses[-101] - early.losses[-1] < 0.01
    assert early.losses == full.losses[: len(early.losses)]
