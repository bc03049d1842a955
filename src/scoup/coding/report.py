"""How well codes stand for the embeddings they were made from."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.codes import SparseCodes


@dataclass(frozen=True)
class CodingReport:
    """Quality and cost of a sparse coding.

    Attributes:
        solver: its name.
        regions: rows coded, rows of norm zero not counted.
        loss: mean of 1 - cosine between a row and its decoded code.
        mean_cosine: mean cosine.
        low_cosine: 5th percentile of the cosine.
        dead_atoms: share of the codebook that no row uses, 0..1.
        epochs: optimisation steps run.
        seconds: wall-clock time of the fit.
    """

    solver: str
    regions: int
    loss: float
    mean_cosine: float
    low_cosine: float
    dead_atoms: float
    epochs: int
    seconds: float

    def __str__(self) -> str:
        return (
            f"{self.solver}: {self.regions} regions, mean cosine {self.mean_cosine:.4f}, "
            f"5th percentile {self.low_cosine:.4f}, dead atoms {100 * self.dead_atoms:.1f} %, "
            f"{self.epochs} epochs in {self.seconds:.1f} s"
        )


def code_cosines(rows: Tensor, atoms: Tensor, codes: SparseCodes) -> Tensor:
    """[R] float32: cosine between each row of ``rows`` [R, D] and its code decoded with ``atoms`` [L, D]; 0
    where either is zero. Decodes in chunks.
    """
    blocks = [
        torch.nn.functional.cosine_similarity(codes.rows(part).to_dense() @ atoms, rows[part], dim=1)
        for part in (slice(start, start + 8192) for start in range(0, len(rows), 8192))
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
    """Measure codes against the rows they stand for; zero rows are left out of the figures."""
    coded = torch.linalg.vector_norm(rows, dim=1) > 0
    cosines = code_cosines(rows, atoms, codes)[coded].double()
    used = codes.indices.long()[codes.weights > 0].unique()
    # With no rows at all nothing is misrepresented.
    mean = float(cosines.mean()) if len(cosines) else 1.0
    low = float(torch.quantile(cosines, 0.05)) if len(cosines) else 1.0
    return CodingReport(
        solver=solver,
        regions=len(cosines),
        loss=1.0 - mean,
        mean_cosine=mean,
        low_cosine=low,
        dead_atoms=1.0 - len(used) / codes.n_atoms,
        epochs=epochs,
        seconds=seconds,
    )
