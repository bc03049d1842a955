"""Is it there at all? So that a query for something absent can return nothing.

The protocols rescale relevancy over the view before they cut it, so that something is painted whatever is asked.
How relevant that place is says little: some places are near to any word. What tells is how far the query stands above
everyday words *there*: the embedding of the answer is compared with the query and with words that have nothing to do
with it, and the query counts as present if its cosine lies some standard deviations above theirs.

Own; the method's paper and the protocols have nothing of the kind, and scores by their rules never use it. Measured in
docs/evaluation.md.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import InputError
from scoup.field.language_field import LanguageField
from scoup.models.words import LEAST_WORDS
from scoup.query.answers import QUERY_PRESETS, QueryPreset, choose_level, level_masks

PRESENT_FROM = 2.0
"""Standard deviations that the query must stand above everyday words."""
_SAME_WORD = 0.99  # cosine between texts from which one is the other, and not a word to compare it with
_AT_A_TIME = 8  # masks in one pass over a view


def standing(answers: Tensor, queries: Tensor, words: Tensor) -> Tensor:
    """How many standard deviations each query's cosine with its answer lies above those of everyday words.

    Args:
        answers: [Q, D] embedding of what was found for each query; of any length, zero for nothing found.
        queries: [Q, D] unit vectors.
        words: [B, D] unit vectors of everyday words. A word that is the query is left out.

    Returns:
        [Q] float32; minus infinity where nothing was found.

    Raises:
        InputError: there are fewer than ``LEAST_WORDS`` words, or shapes do not fit.
    """
    if answers.shape != queries.shape or words.dim() != 2 or words.shape[1:] != queries.shape[1:]:
        raise InputError(
            f"answers {list(answers.shape)}, queries {list(queries.shape)} and words {list(words.shape)} do not fit"
        )
    if len(words) < LEAST_WORDS:
        raise InputError(f"presence is judged against {LEAST_WORDS} everyday words or more, got {len(words)}")
    found, asked, others = (
        torch.nn.functional.normalize(each.double().cpu(), dim=1) for each in (answers, queries, words)
    )
    cosines = found @ others.T  # [Q, B]
    kept = (asked @ others.T < _SAME_WORD).double()
    count = kept.sum(1).clamp(min=1)
    mean = (cosines * kept).sum(1) / count
    spread = ((cosines - mean[:, None]).square() * kept).sum(1).div(count).sqrt()
    own = (found * asked).sum(1)
    above = (own - mean) / spread.clamp(min=1e-6)
    return torch.where(answers.cpu().any(1), above, -torch.inf).float()


def view_standing(
    field: LanguageField,
    view: raster.Projection,
    relevancy: Tensor,
    queries: Tensor,
    words: Tensor,
    preset: QueryPreset = QUERY_PRESETS["default"],
) -> Tensor:
    """[Q] how far each query stands above everyday words in what a view answers (``standing``).

    Args:
        field: that was asked.
        view: of its Gaussians.
        relevancy: [S, Q, H, W] that the field gave in that view.
        queries: [Q, D] unit vectors that it was asked with.
        words: [B, D] unit vectors of everyday words.
        preset: by which answers are made.
    """
    cores = [answer_core(maps, preset) for maps in relevancy.unbind(1)]
    answers = torch.zeros(len(cores), field.dim)
    for start in range(0, len(cores), _AT_A_TIME):
        part = cores[start : start + _AT_A_TIME]
        labels = torch.stack([core.int() - 1 for _, core in part])
        sums = raster.region_sums(view, labels)
        for number, (level, _) in enumerate(part):
            gaussian, _, weight = sums.triplets(number)
            answers[start + number] = mean_embedding(field, level, gaussian, weight)
    return standing(answers, queries, words)


def scene_standing(
    field: LanguageField, selections: Iterable[tuple[Tensor, Tensor, int]], queries: Tensor, words: Tensor
) -> Tensor:
    """[Q] how far each query stands above everyday words in the Gaussians selected for it, without rendering.

    Args:
        field: that was asked.
        selections: for each query, what ``select_with_level`` gives.
        queries: [Q, D] unit vectors.
        words: [B, D] unit vectors of everyday words.
    """
    answers = torch.zeros(len(queries), field.dim)
    for row, (chosen, relevancy, level) in enumerate(selections):
        if chosen.any():
            core = (chosen & (relevancy >= relevancy[chosen].median())).nonzero()[:, 0]
            answers[row] = mean_embedding(field, level, core, field.gaussians.opacities[core])
    return standing(answers, queries, words)


def answer_core(relevancy: Tensor, preset: QueryPreset = QUERY_PRESETS["default"]) -> tuple[int, Tensor]:
    """The level that answers, and the more relevant half of its mask [H, W]: borders, where things mix, stay out. Of
    an empty mask, the most relevant pixels.

    Args:
        relevancy: [S, H, W] of one query.
        preset: by which the answer is made.
    """
    smoothed, masks = level_masks(relevancy, preset)
    level = choose_level(smoothed, masks, preset.level_choice)
    shown, mask = smoothed[level], masks[level]
    if not mask.any():
        return level, shown == shown.max()
    return level, mask & (shown >= shown[mask].median())


def mean_embedding(field: LanguageField, level: int, gaussians: Tensor, weights: Tensor) -> Tensor:
    """[D] on the CPU: sum of the decoded codes of some Gaussians [M] by weights [M], at one level."""
    # On the CPU: sums by index on a GPU are not the same twice.
    atoms = field.code_indices[gaussians, level].cpu().long()
    shares = (field.code_weights[gaussians, level].float() * weights[:, None]).cpu()
    code = torch.bincount(atoms.flatten(), shares.flatten().double(), field.n_atoms)
    return code.float() @ field.codebook[level].cpu()


def vote_entropy(weights: Tensor) -> Tensor:
    """[N, S] float32 entropy of votes, 0 (all views agree) to 1; 1 for a Gaussian without a code.

    Args:
        weights: [N, S, K] not negative: those of codes as stored, or of all atoms.
    """
    weights = weights.float()
    total = weights.sum(-1, keepdim=True)
    share = torch.where(total > 0, weights / total.clamp(min=1e-30), 0.0)
    found = torch.special.entr(share).sum(-1) / torch.tensor(float(max(2, weights.shape[-1]))).log()
    return torch.where(total[..., 0] > 0, found, 1.0)
