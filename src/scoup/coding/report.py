"""Quality of codes: how well they represent the embeddings they were made from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import counted
from scoup.scene import SparseCodes

LEAST_EXPLAINED = 0.01  # cosine; rows without a code are badly explained whatever was learned
ROUNDING = 1e-5  # of a cosine, between a fit and the same rows coded again


@dataclass(frozen=True)
class CodingReport:
    """Quality and cost of a sparse coding."""

    solver: str
    """Its name."""
    regions: int
    """Rows coded, rows of norm zero not counted."""
    loss: float
    """Mean of 1 - cosine between a row and its decoded code."""
    mean_cosine: float
    """Mean cosine."""
    low_cosine: float
    """5th percentile of the cosine."""
    dead_atoms: float
    """Share of the codebook that no row uses, 0..1."""
    epochs: int
    """Optimisation steps run."""
    seconds: float
    """Wall-clock time of the fit."""
    explained_from: float
    """Cosine below which a row that was not learned from counts as badly explained."""

    def __str__(self) -> str:
        return (
            f"{self.solver}: {counted(self.regions, 'region')}, mean cosine {self.mean_cosine:.4f}, "
            f"5th percentile {self.low_cosine:.4f}, unused atoms {100 * self.dead_atoms:.1f} %, "
            f"{self.epochs} epochs in {self.seconds:.1f} s"
        )


def decoded_cosines(rows: Tensor, atoms: Tensor, codes: SparseCodes) -> Tensor:
    """Return [R] float32: cosine between each row [R, D] and its code decoded with ``atoms`` [L, D] in chunks; 0 where
    either is zero."""
    blocks = [
        torch.nn.functional.cosine_similarity(codes.rows(block).to_dense() @ atoms, rows[block], dim=1)
        for block in (slice(start, start + 8192) for start in range(0, len(rows), 8192))
    ]
    return torch.cat(blocks) if blocks else rows.new_zeros(0)


def report_on(
    rows: Tensor,  # [R, D]
    atoms: Tensor,  # [L, D]
    codes: SparseCodes,
    solver: str = "",
    epochs: int = 0,
    seconds: float = 0.0,
) -> CodingReport:
    """Measure codes against their rows; zero rows are left out of the figures."""
    coded = torch.linalg.vector_norm(rows, dim=1) > 0
    cosines = decoded_cosines(rows, atoms, codes)[coded].double()
    # Without rows nothing is misrepresented.
    mean = float(cosines.mean()) if len(cosines) else 1.0
    low = float(torch.quantile(cosines, 0.05)) if len(cosines) else 1.0
    return CodingReport(
        solver=solver,
        regions=len(cosines),
        loss=1.0 - mean,
        mean_cosine=mean,
        low_cosine=low,
        dead_atoms=1.0 - len(codes.indices.long()[codes.weights > 0].unique()) / codes.n_atoms,
        epochs=epochs,
        seconds=seconds,
        explained_from=explained_from(low, len(cosines), codes.n_atoms),
    )


def explained_from(low_cosine: float, regions: int, n_atoms: int) -> float:
    """Return the least cosine of a well-explained held-out row, 0..1.

    The 5th percentile of the training rows is no measure of others where atoms are many: an atom learned from n rows
    lies nearer to them than to the next row of the same thing. A fit errs by 1 - 1/n on its own rows and by 1 + 1/n on
    others, n = regions / atoms (Akaike's final prediction error), so the distance is scaled by the ratio of the two.
    With no more rows than atoms nothing is known: whatever differs from the training rows is below the threshold.
    """
    factor = (regions + n_atoms) / (regions - n_atoms) if regions > n_atoms else 1.0
    return max(1.0 - (1.0 - low_cosine) * factor - ROUNDING, LEAST_EXPLAINED)
