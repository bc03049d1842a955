"""The paper's solver: codes and codebook learned together by Adam (method.md, stage 1).

Per region r with unit embedding f, support logits p and atoms C the loss is 1 - c with

    w = softmax(p),  s = C f,  G = C C^T,  n^2 = w^T G w,  c = (w . s) / n

over the K atoms of its support (the K largest logits), and its gradients are, with g = G w,

    dc/dp_k = w_k (s_k / n - c g_k / n^2)        (the softmax's centring term is zero: c ignores w's scale)
    dc/dC   = (w / n) f^T - (c / n^2) w w^T C    (summed over regions)

so no vector of D numbers is ever formed per region, which autograd would do: it takes twenty times as long.
``tests/coding/test_adam.py`` has the plain form.
"""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from scoup.base import Progress, no_progress
from scoup.coding.backends import CodingBackend, RowCodes, as_sparse_codes, coding_backend
from scoup.coding.codebook import Solution
from scoup.coding.kmeans import spherical_kmeans

LEARNING_RATE = 7e-4  # the paper's
LOGIT_SCALE = 4.0
"""Initial logits are this times the cosine to the initial atoms.

Measured on the m | s regions of a kitchen, loss after 1000 and 4000 epochs: scale 0 (all logits equal)
.066 .056 | .080 .067; 1: .065 .055 | .075 .066; 4: .062 .057 | .072 .067; 10: .061 .059 | .072 .070. Small
scales end a little lower; large ones start lower.
"""
STOP_WINDOW = 100  # epochs over which ``tolerance`` is judged
START_ITERATIONS = 10  # of k-means
_TINY = 1e-30


def solve_adam(
    rows: Tensor,  # [R, D]
    n_atoms: int,
    k: int,
    seed: int = 0,
    epochs: int = 4000,
    tolerance: float | None = None,
    progress: Progress = no_progress,
    backend: str | None = None,
) -> Solution:
    """Learn atoms and K-sparse codes of unit rows by full-batch Adam (method.md, stage 1, "the paper's solver").

    The work is done on the CPU, wherever the rows are. ``k`` above L counts as L. It stops once the mean loss has
    fallen by less than ``tolerance`` over the last 100 epochs. ``progress`` is called after every epoch, as stage
    "sparse coding".
    """
    ours = rows.detach().cpu().float().contiguous()
    arithmetic = coding_backend(backend)
    atoms = spherical_kmeans(ours, n_atoms, torch.Generator().manual_seed(seed), arithmetic, START_ITERATIONS)
    logits = LOGIT_SCALE * arithmetic.row_products(ours, atoms)
    support = logits.topk(min(k, n_atoms), dim=1).indices
    logits.grad, atoms.grad = torch.zeros_like(logits), torch.zeros_like(atoms)
    optimizer = torch.optim.Adam([logits, atoms], lr=LEARNING_RATE, fused=True)
    losses: list[float] = []
    done = 0
    progress("sparse coding", 0, epochs)
    for epoch in range(1, epochs + 1):
        weights = logits.gather(1, support).softmax(1)
        loss, logit_gradient, atoms.grad = loss_and_gradients(ours, atoms, support, weights, arithmetic)
        losses.append(loss)
        if tolerance is not None and epoch > STOP_WINDOW and losses[-1 - STOP_WINDOW] - loss < tolerance:
            break
        logits.grad.zero_().scatter_(1, support, logit_gradient)
        optimizer.step()
        _update_support(support, logits)
        done = epoch
        progress("sparse coding", epoch, epochs)
    weights, order = logits.gather(1, support).softmax(1).sort(dim=1, descending=True, stable=True)
    row_codes = RowCodes(support.gather(1, order), weights, torch.ones(len(ours)))
    codes = as_sparse_codes(row_codes, n_atoms, k, rows.device)
    return Solution(atoms.to(rows.device), codes, done, tuple(losses))


def loss_and_gradients(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    support: Tensor,  # [R, K] int64
    weights: Tensor,  # [R, K]
    backend: CodingBackend,
) -> tuple[float, Tensor, Tensor]:
    """Return the mean loss of codes, and its gradients by the logits of the support [R, K] and by the atoms [L, D]."""
    toward = _similarities(rows, atoms, support)
    gram = atoms @ atoms.T
    within = (gram[support[:, :, None], support[:, None]] * weights[:, None]).sum(2)
    inverse = (within * weights).sum(1, keepdim=True).clamp(min=_TINY).rsqrt()  # 1 / n
    cosines = (weights * toward).sum(1, keepdim=True) * inverse
    logit_gradient = weights * inverse * (within * cosines * inverse - toward) / len(rows)
    # With weights (c / n) w, each row counted 1 / c times, the sums are those of dc/dC.
    shares = cosines.clamp(min=_TINY)
    codes = RowCodes(support.int(), weights * inverse * shares, shares[:, 0])
    moments, pull = backend.code_moments(rows, codes, shares[:, 0].reciprocal(), len(atoms))
    atom_gradient = (moments.float() @ atoms - pull.float()) / len(rows)
    return 1.0 - float(cosines.mean()), logit_gradient, atom_gradient


def _similarities(rows: Tensor, atoms: Tensor, support: Tensor) -> Tensor:
    """Return [R, K], the inner products of rows with the atoms of their support, a few of all L."""
    count, k = support.shape
    starts = torch.arange(0, count * k + 1, k)
    with warnings.catch_warnings():
        # torch calls its CSR tensors beta; the one operation used here is checked by our tests.
        warnings.filterwarnings("ignore", message="Sparse (CSR|invariant)", category=UserWarning)
        places = torch.sparse_csr_tensor(
            starts, support.flatten(), torch.zeros(count * k), (count, len(atoms)), check_invariants=False
        )
        return torch.sparse.sampled_addmm(places, rows, atoms.T, beta=0.0).values().view(count, k)


def _update_support(support: Tensor, logits: Tensor) -> None:
    """Update the K largest logits of rows where another has overtaken one of them: faster than of all rows."""
    supported = logits.gather(1, support)
    others = logits.scatter(1, support, -torch.inf).amax(1)
    changed = (others > supported.amin(1)).nonzero()[:, 0]
    support[changed] = logits[changed].topk(support.shape[1], dim=1).indices
