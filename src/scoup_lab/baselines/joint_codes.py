"""LangSplatV2, reimplemented: codebook and codes of Gaussians learned together, by comparing renderings with regions.

What sparse code uplifting does without (method.md). It stores the same as a language field, but every step renders a
view: with w_i the code of Gaussian i (the softmax over its logits, the K largest kept and scaled to sum 1) and C the
codebook, the feature of pixel p is (sum over i of e_i(p) w_i) C, and Adam lowers the mean of 1 - its cosine with the
embedding of the region there. Each level by itself; geometry stays as it is.

Followed from LangSplatV2's paper (arXiv 2507.07136) and public code: 64 atoms, 4 kept, all logits zero at the start,
the codebook from k-means, one view a step in shuffled rounds, 10000 steps per level, Adam with rate 0.0025 and epsilon
1e-15 for logits and codebook alike, cosine loss alone.

Where this departs from it:

* Views are small (``JointSettings.width``), their blending weights are kept as sparse matrices and multiplied at each
  step (``view_weights``); theirs are rasterised at full size each time. Steps here cost far less than theirs would on
  the same machine.
* The cosine needs the rendered coefficients, their similarities C f and C C^T only, so that no [P, D] image of features
  is made. The same loss and gradients, computed for less.
* The loss is the mean over pixels with a region; theirs counts the others as a constant, which scales it.
* k-means is spherical and of all regions of the level; theirs is scikit-learn's in mini-batches.
* Of equal logits, as at the start, the first atoms are kept; theirs are torch's choice on a GPU.
* Gaussians that contribute to no pixel with a region in any view have no code; theirs keep that of the start.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import InputError, Progress, no_progress
from scoup.coding import coding_backend, spherical_kmeans
from scoup.scene import index_dtype, normalise_embeddings
from scoup_lab.baselines.view_weights import ViewWeights, rendered

_EPSILON = 1e-15  # of Adam, as in their code
_ITERATIONS = 10  # of k-means
_TINY = 1e-16  # squared norm of a rendered feature, below which it has no direction


@dataclass(frozen=True)
class JointSettings:
    """Sizes and schedule; all but the width are LangSplatV2's."""

    iterations: int = 10_000  # steps of each level
    n_atoms: int = 64  # L
    k: int = 4  # atoms of a code
    learning_rate: float = 2.5e-3  # of Adam
    width: int = 120  # of the views learned from, in pixels; *choice*

    def departure(self) -> str:
        """Return how the schedule departs from the published one; "" if it does not."""
        published = LANGSPLATV2.iterations
        return "" if self.iterations == published else f"{self.iterations:,} of {published:,} steps"


LANGSPLATV2 = JointSettings()


@dataclass(frozen=True, eq=False)
class JointCodes:
    """Codes and codebook that were learned."""

    indices: Tensor  # [N, S, K] uint8 (uint16 beyond 256 atoms), the atoms of each Gaussian
    # [N, S, K] float32, not negative, largest first, summing to 1; zeros for a Gaussian that contributes to no pixel
    # with a region
    weights: Tensor
    codebook: Tensor  # [S, L, D] float32, not of unit norm
    losses: tuple[tuple[float, ...], ...]  # per level the loss before each step, of the view of that step


@dataclass(frozen=True, eq=False)
class ViewTargets:
    """The target of a view at one level."""

    pixels: Tensor  # [P] int64, those of ``ViewWeights.weights`` that have a region
    regions: Tensor  # [P] int64, which one
    embeddings: Tensor  # [R, D] float32 unit rows of the view's regions


def fit_joint_codes(
    views: Sequence[ViewWeights],
    embeddings: Sequence[Tensor],
    rows: Sequence[Mapping[str, slice]],
    n_gaussians: int,
    settings: JointSettings = LANGSPLATV2,
    seed: int = 0,
    progress: Progress = no_progress,
) -> JointCodes:
    """Learn codebook and codes of each level through the renderings of its views. The same input and seed give the same
    codes.

    ``views``: of the scene, see ``weights_of_views``; ``embeddings``: per level [R, D], of the regions of all
    views, any norm; ``settings``: see ``JointSettings``.
    """
    if settings.iterations < 0:
        raise InputError(f"iterations must not be negative, got {settings.iterations}")
    indices, weights, books, losses = [], [], [], []
    total = len(embeddings) * settings.iterations
    progress("joint codes", 0, total)
    for level, of_level in enumerate(embeddings):
        targets = _targets(views, of_level, rows[level], level)
        training = _Training(views, targets, n_gaussians, settings, seed)
        for _ in range(settings.iterations):
            training.step()
            progress("joint codes", level * settings.iterations + len(training.losses), total)
        codes = training.codes()
        indices.append(codes[0])
        weights.append(codes[1])
        books.append(training.atoms.detach())
        losses.append(tuple(training.losses))
    return JointCodes(torch.stack(indices, 1), torch.stack(weights, 1), torch.stack(books), tuple(losses))


def top_codes(logits: Tensor, k: int) -> tuple[Tensor, Tensor]:
    """Return atoms [M, K] int64 and weights [M, K] of logits [M, L]: the softmax, its K largest kept and scaled
    to sum 1, which is the softmax over the K largest logits. Largest first; of equal ones the first."""
    # One largest after the other and not topk, which picks any of equal logits and takes longer for few.
    left = logits.detach().clone()
    atoms = []
    for _ in range(k):
        atoms.append(left.argmax(1, keepdim=True))
        left.scatter_(1, atoms[-1], -torch.inf)
    indices = torch.cat(atoms, 1)
    return indices, logits.gather(1, indices).softmax(1)


def rendering_loss(view: ViewWeights, logits: Tensor, atoms: Tensor, targets: ViewTargets, k: int) -> Tensor:
    """Return the mean of 1 - cosine of rendered features and embeddings, over the pixels of a view that have a region.

    ``logits``: [M, L] of its members; ``atoms``: [L, D].
    """
    indices, weights = top_codes(logits, k)
    codes = torch.zeros_like(logits).scatter(1, indices, weights)
    coefficients = rendered(view, codes)[targets.pixels]  # [P, L]
    toward = (targets.embeddings @ atoms.T)[targets.regions]
    squared = ((coefficients @ (atoms @ atoms.T)) * coefficients).sum(1)
    cosine = (coefficients * toward).sum(1) * squared.clamp(min=_TINY).rsqrt()
    return 1 - cosine.mean()


def _targets(
    views: Sequence[ViewWeights], embeddings: Tensor, rows: Mapping[str, slice], level: int
) -> list[ViewTargets]:
    unit = normalise_embeddings(embeddings)
    targets = []
    for view in views:
        labels = view.labels[level]
        pixels = (labels >= 0).nonzero()[:, 0]
        targets.append(ViewTargets(pixels, labels[pixels], unit[rows[view.name]]))
    return targets


class _Training:
    """One level on the way."""

    def __init__(
        self,
        views: Sequence[ViewWeights],
        targets: Sequence[ViewTargets],
        n_gaussians: int,
        settings: JointSettings,
        seed: int,
    ) -> None:
        seen = [number for number, target in enumerate(targets) if len(target.pixels)]
        if not seen:
            raise InputError("a level without a region in any view has nothing to learn from")
        self.views = [views[number] for number in seen]
        self.targets = [targets[number] for number in seen]
        self.settings = settings
        rows = torch.cat([target.embeddings for target in self.targets])
        random = torch.Generator().manual_seed(seed)
        atoms = spherical_kmeans(rows, settings.n_atoms, random, coding_backend(), _ITERATIONS)
        self.atoms = atoms.requires_grad_()
        self.logits = torch.zeros(n_gaussians, settings.n_atoms, requires_grad=True)
        self.adam = torch.optim.Adam([self.logits, self.atoms], lr=settings.learning_rate, eps=_EPSILON)
        self.order = _shuffled(len(self.views), seed)
        self.losses: list[float] = []

    def step(self) -> None:
        number = next(self.order)
        view = self.views[number]
        logits = self.logits[view.members]
        loss = rendering_loss(view, logits, self.atoms, self.targets[number], self.settings.k)
        self.adam.zero_grad()
        loss.backward()
        self.adam.step()
        self.losses.append(loss.item())

    def codes(self) -> tuple[Tensor, Tensor]:
        """Return indices and weights [N, K] as ``JointCodes`` has them."""
        indices, weights = top_codes(self.logits.detach(), self.settings.k)
        contributes = torch.zeros(len(indices), dtype=torch.bool)
        for view, target in zip(self.views, self.targets, strict=True):
            contributes[view.members[view.weights[target.pixels.numpy()].sum(0) > 0]] = True
        return indices.to(index_dtype(self.settings.n_atoms)), torch.where(contributes[:, None], weights, 0.0)


def _shuffled(count: int, seed: int) -> Iterator[int]:
    """Yield numbers below ``count``, all of them in a new order again and again."""
    random = torch.Generator().manual_seed(seed)
    while True:
        yield from torch.randperm(count, generator=random).tolist()
