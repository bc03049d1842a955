"""Stage 1: a codebook and sparse codes of region embeddings. Knows nothing of 3D."""

from __future__ import annotations

import time

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import InputError, Progress, no_progress
from scoup.coding.adam import solve_adam
from scoup.coding.backends import coding_backend
from scoup.coding.codebook import Codebook, Solution, encode, encode_rows
from scoup.coding.distinct import value_codes
from scoup.coding.exact import EFFORTS, solve_exact
from scoup.coding.kmeans import spherical_kmeans
from scoup.coding.report import CodingReport, decoded_cosines, report_on
from scoup.scene import SparseCodes, index_dtype, normalise_embeddings

__all__ = [
    "Codebook",
    "CodingReport",
    "coding_backend",
    "decoded_cosines",
    "encode",
    "encode_rows",
    "fit_codes",
    "report_on",
    "spherical_kmeans",
]


SOLVERS = ("adam", "exact")


def fit_codes(  # noqa: PLR0913  the public face: each keyword is one choice of the user
    embeddings: Tensor | ArrayLike,  # [R, D]
    n_atoms: int = 64,
    k: int = 4,
    solver: str = "exact",
    seed: int = 0,
    epochs: int = 4000,
    tolerance: float | None = None,
    effort: str = "best",
    backend: str | None = None,
    progress: Progress = no_progress,
) -> Codebook:
    """Learn a codebook of L atoms and a K-sparse non-negative code for every embedding (method.md, stage 1).

    Every embedding counts alike, whatever its norm. Embeddings of norm zero get empty codes. There may be
    fewer embeddings than atoms; some atoms are then copies of each other. Same input, seed and
    number of threads, same result; "exact" with the compiled core gives it for any number of threads.

    Where embeddings take few values, at most L and each that of two embeddings or more on average, "exact" learns
    nothing: the values are the atoms, followed by zeros, and a code is one atom (``scoup.coding.distinct``).

    Args:
        embeddings: [R, D] floating point, one row per region; a tensor or a numpy array.
        n_atoms: L, 1 to 65536.
        k: K, the most atoms a code may use, 1 to 64.
        solver: one of ``SOLVERS``; "exact" (the default) reaches a lower loss than the paper's "adam" in a fraction of
            its time.
        seed: of the random start.
        epochs: full-batch optimisation steps of "adam" at most; "exact" has a schedule of its own (``solve_exact``).
        tolerance: "adam" stops early, once the mean of 1 - cosine has fallen by less than this over 100 epochs.
        effort: "fast" or "best" (the default): how long "exact" learns; see ``scoup.coding.exact.EFFORTS``.
        backend: by name (``scoup.coding.backends``); by default the compiled core if there is one.
        progress: called after each epoch or step. An exception it raises (or Ctrl-C) stops the fit and nothing is kept.

    Raises:
        InputError: if the embeddings are not [R, D] or not finite, or a setting is out of range.

    Example:
        >>> embeddings = torch.randn(50, 16, generator=torch.Generator().manual_seed(0))
        >>> codebook = scoup.fit_codes(embeddings, n_atoms=8, k=2)
        >>> codebook.codes.indices.shape  # two atoms for each embedding
        torch.Size([50, 2])
    """
    if solver not in SOLVERS:
        raise InputError(f"there is no solver {solver!r}; solvers: {', '.join(map(repr, SOLVERS))}")
    if not 1 <= k <= 64:
        raise InputError(f"k must be 1 to 64 atoms per code, got {k}")
    if epochs < 0:
        raise InputError(f"epochs must not be negative, got {epochs}")
    if effort not in EFFORTS:
        raise InputError(f"there is no effort {effort!r}; efforts: {', '.join(map(repr, EFFORTS))}")
    index_dtype(n_atoms)  # checks its range
    started = time.perf_counter()
    rows = normalise_embeddings(embeddings)
    coded = (rows != 0).any(1)
    if coded.any():
        if solver == "adam":
            solution = solve_adam(rows[coded], n_atoms, k, seed, epochs, tolerance, progress, backend)
        else:
            solution = _exact(rows[coded], n_atoms, k, seed, effort, progress, backend)
        atoms, codes, run = solution.atoms, _spread(solution.codes, coded), solution.steps
    else:
        run = 0
        atoms = rows.new_zeros(n_atoms, rows.shape[1])
        codes = SparseCodes.from_dense(rows.new_zeros(len(rows), n_atoms), k)
    seconds = time.perf_counter() - started
    return Codebook(atoms, codes, report_on(rows, atoms, codes, solver, run, seconds))


def _exact(
    rows: Tensor, n_atoms: int, k: int, seed: int, effort: str, progress: Progress, backend: str | None
) -> Solution:
    known = value_codes(rows, n_atoms, k)
    if known is None:
        return solve_exact(rows, n_atoms, k, seed, EFFORTS[effort], progress, backend)
    progress("sparse coding", 0, 1)
    progress("sparse coding", 1, 1)
    return Solution(*known, 0, ())


def _spread(codes: SparseCodes, coded: Tensor) -> SparseCodes:
    """Put the codes at the rows where ``coded`` [R] is true, and empty codes elsewhere."""
    if coded.all():
        return codes
    indices = torch.zeros(len(coded), codes.k, dtype=torch.long, device=coded.device)
    weights = torch.zeros(len(coded), codes.k, device=coded.device)
    indices[coded] = codes.indices.long()
    weights[coded] = codes.weights
    return SparseCodes(indices.to(codes.indices.dtype), weights, codes.n_atoms)
