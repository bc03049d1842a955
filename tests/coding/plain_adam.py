"""The paper's solver in its plain form: dense logits, D-dimensional reconstructions, autograd, Adam."""

from __future__ import annotations

import torch
from torch import Tensor


def plain_adam(
    rows: Tensor, atoms: Tensor, logits: Tensor, k: int, epochs: int, learning_rate: float
) -> tuple[Tensor, Tensor, list[float]]:
    """Atoms [L, D], logits [R, L] after ``epochs`` steps, and the loss before each step."""
    atoms = atoms.clone().requires_grad_()
    logits = logits.clone().requires_grad_()
    optimizer = torch.optim.Adam([logits, atoms], lr=learning_rate)
    losses = []
    for _ in range(epochs):
        optimizer.zero_grad()
        loss = plain_loss(rows, atoms, logits, k)
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    return atoms.detach(), logits.detach(), losses


def plain_loss(rows: Tensor, atoms: Tensor, logits: Tensor, k: int) -> Tensor:
    soft = torch.softmax(logits, dim=1)
    values, indices = torch.topk(soft, k, dim=1)
    weights = torch.zeros_like(soft).scatter(1, indices, values)
    weights = weights / weights.sum(1, keepdim=True)
    return (1 - torch.nn.functional.cosine_similarity(weights @ atoms, rows, dim=1)).mean()
