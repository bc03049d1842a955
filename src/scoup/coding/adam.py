"""The paper's solver: codes and codebook learned together by Adam (method.md, stage 1), done cheaply.

Per region r with unit embedding f, support logits p and atoms C the loss is 1 - c with

    w = softmax(p),  s = C f,  G = C C^T,  n^2 = w^T G w,  c = (w . s) / n

over the K atoms of its support (the K largest logits), and its gradients are, with g = G w,

    dc/dp_k = w_k (s_k / n - c g_k / n^2)        (the softmax's centring term is zero: c ignores w's scale)
    dc/dC   = (w / n) f^T - (c / n^2) w w^T C    (summed over regions)

so no vector of D numbers is ever formed per region. Logits outside the support have no gradient: those that
were never in it do not move at all, and are not touched until they are within reach of it (see ``Slots``).
The plain form, D-dimensional autograd over dense logits, is the oracle of ``tests/coding/test_adam.py``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base.progress import Progress, no_progress
from scoup.coding.kmeans import spherical_kmeans
from scoup.coding.products import products_for
from scoup.coding.slots import Slots, Step, add_gradient, decay
from scoup.scene.codes import SparseCodes, index_dtype

LEARNING_RATE = 7e-4  # the paper's
LOGIT_SCALE = 4.0
"""Initial logits are this times the cosine to the initial atoms.

Measured on the m | s regions of a kitchen, loss after 1000 and 4000 epochs: scale 0 (all logits equal)
.066 .056 | .080 .067; 1: .065 .055 | .075 .066; 4: .062 .057 | .072 .067; 10: .061 .059 | .072 .070. Small
scales end a little lower; large ones start lower and run faster, since fewer logits come within reach.
"""
STOP_WINDOW = 100  # epochs over which ``tolerance`` is judged
_FLUSH_EVERY = 64
_TINY = 1e-30


@dataclass(frozen=True)
class AdamSettings:
    """Settings of the solver."""

    epochs: int = 4000  # full-batch steps
    learning_rate: float = LEARNING_RATE  # of logits and codebook
    tolerance: float | None = None  # stop once the mean loss has fallen by less over the last 100 epochs


@dataclass(frozen=True, eq=False)
class AdamSolution:
    """The result of the solver."""

    atoms: Tensor  # [L, D] float32, not of unit norm
    codes: SparseCodes  # of the rows
    epochs: int  # run
    losses: tuple[float, ...]  # mean, before each epoch


def solve_adam(
    rows: Tensor,  # [R, D]
    n_atoms: int,
    k: int,
    seed: int = 0,
    settings: AdamSettings | None = None,
    progress: Progress = no_progress,
    initial_atoms: Tensor | None = None,  # [L, D]
) -> AdamSolution:
    """Learn atoms and K-sparse codes of unit rows by full-batch Adam (method.md, stage 1, "the paper's solver").

    ``k`` above L counts as L. ``progress`` is called after every epoch, as stage "sparse coding". The codebook starts
    from ``initial_atoms``, by default spherical k-means of the rows.
    """
    settings = settings or AdamSettings()
    atoms = spherical_kmeans(rows, n_atoms, seed) if initial_atoms is None else initial_atoms.clone()
    slots = Slots(_initial_logits(rows, atoms), min(k, n_atoms))
    products = products_for(rows, n_atoms)
    products.set_support(slots.support)
    first, second = torch.zeros_like(atoms), torch.zeros_like(atoms)
    losses: list[float] = []
    done = 0
    progress("sparse coding", 0, settings.epochs)
    for epoch in range(1, settings.epochs + 1):
        weights = slots.weights()
        toward = products.similarities(atoms)  # s
        within = (products.gram_on_support(atoms @ atoms.T) * weights[None]).sum(1)  # g = G w
        inverse = (within * weights).sum(0).clamp_(min=_TINY).rsqrt_()  # 1 / n
        cosine = (weights * toward).sum(0) * inverse
        losses.append(1.0 - float(cosine.mean()))
        if _stalled(losses, settings.tolerance):
            break
        share = inverse / len(rows)  # the loss is a mean over regions
        shrink = cosine * inverse * share
        logit_gradient = weights * (within * shrink - toward * share)
        atom_gradient = products.moments(weights, shrink) @ atoms - products.pull(weights * share)

        step = Step.of_epoch(epoch, settings.learning_rate)
        slots.step(logit_gradient, step, flush=epoch % _FLUSH_EVERY == 0)
        decay(first, second)
        add_gradient(first, second, atom_gradient)
        step.move(atoms, first, second)
        if slots.settle():
            products.set_support(slots.support)
        done = epoch
        progress("sparse coding", epoch, settings.epochs)
    return AdamSolution(atoms, _codes(slots, n_atoms, k), done, tuple(losses))


def _initial_logits(rows: Tensor, atoms: Tensor) -> Tensor:
    """[R, L] float32."""
    norms = torch.linalg.vector_norm(atoms, dim=1).clamp(min=_TINY)
    return rows @ (atoms / norms[:, None]).T * LOGIT_SCALE


def _stalled(losses: list[float], tolerance: float | None) -> bool:
    return (
        tolerance is not None
        and len(losses) > STOP_WINDOW
        and losses[-1 - STOP_WINDOW] - losses[-1] < tolerance
    )


def _codes(slots: Slots, n_atoms: int, k: int) -> SparseCodes:
    weights, order = torch.sort(slots.weights().T.float(), dim=1, descending=True, stable=True)
    indices = slots.support.T.gather(1, order)
    indices = torch.where(weights > 0, indices, 0)
    missing = k - weights.shape[1]
    if missing > 0:
        weights = torch.nn.functional.pad(weights, (0, missing))
        indices = torch.nn.functional.pad(indices, (0, missing))
    return SparseCodes(indices.to(index_dtype(n_atoms)), weights.contiguous(), n_atoms)
