"""How far the regions' codes agree with what each Gaussian was voted to be: the weights of a second round."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.codes import SparseCodes, index_dtype, row_products
from scoup.errors import InputError

LEAST_AGREEMENT = 1e-6  # no Gaussian loses its code for being odd
_ROWS_AT_A_TIME = 1 << 17


@dataclass(frozen=True, eq=False)
class Agreement:
    """The outcome of an earlier round of the vote, and how strictly regions are held to it.

    In a later round, region r counts for Gaussian i not A[i, r] but A[i, r] exp(sharpness (cos - 1)), where cos is the
    cosine between the decoded code of the region and that of the Gaussian: masks that bleed over an edge and embeddings
    of something else lose their say. (Own; the one-round vote is method.md, stage 2.) A Gaussian without a code weighs
    all regions alike.

    Attributes:
        indices: [N, S, K] uint8 (uint16 beyond 256 atoms), the codes of the Gaussians.
        weights: [N, S, K] float32, scaled so that each decoded code has unit norm; zeros for no code.
        grams: [S, L, L] float32, inner products of the atoms.
        sharpness: [S] float32, 0 or more; 0 counts all regions alike.
    """

    indices: Tensor  # [N, S, K]
    weights: Tensor  # [N, S, K]
    grams: Tensor  # [S, L, L]
    sharpness: Tensor  # [S]

    def __post_init__(self) -> None:
        levels = self.indices.shape[1] if self.indices.dim() == 3 else -1
        if self.indices.shape != self.weights.shape or levels < 0:
            raise InputError(
                f"indices {list(self.indices.shape)} and weights {list(self.weights.shape)} must be [N, S, K]"
            )
        if self.grams.dim() != 3 or len(self.grams) != levels or tuple(self.sharpness.shape) != (levels,):
            raise InputError(
                f"grams {list(self.grams.shape)} and sharpness {list(self.sharpness.shape)} do not fit {levels} levels"
            )
        if self.indices.dtype != index_dtype(self.n_atoms):
            raise InputError(f"indices are {self.indices.dtype}, expected {index_dtype(self.n_atoms)}")

    @property
    def n_atoms(self) -> int:
        return self.grams.shape[1]

    @classmethod
    def with_codes(cls, indices: Tensor, weights: Tensor, codebook: Tensor, sharpness: Tensor) -> Agreement:
        """Of the codes of Gaussians.

        Args:
            indices: [N, S, K] uint8 (uint16 beyond 256 atoms).
            weights: [N, S, K] in any scale, not negative.
            codebook: [S, L, D] float32.
            sharpness: [S].
        """
        grams = torch.stack([row_products(atoms, atoms) for atoms in codebook]).to(weights.device)
        weights = _scaled_to_unit_norm(indices, weights, grams)
        return cls(indices, weights, grams, sharpness.to(weights.device, torch.float32))

    def to(self, device: torch.device | str) -> Agreement:
        parts = (self.indices, self.weights, self.grams, self.sharpness)
        return Agreement(*(part.to(device) for part in parts))

    def with_sharpness(self, sharpness: Tensor) -> Agreement:
        """The same votes held to more or less strictly."""
        return Agreement(self.indices, self.weights, self.grams, sharpness.to(self.sharpness))

    def region_cosines(self, codes: list[SparseCodes]) -> list[Tensor]:
        """Per level [R, L] float32: inner products of each region's decoded code, at unit norm, with the atoms."""
        tables = []
        for gram, level in zip(self.grams, codes, strict=True):
            atoms, weights = level.indices.long().to(gram.device), level.weights.to(gram.device)
            if level.n_atoms != self.n_atoms:
                raise InputError(f"codes over {level.n_atoms} atoms, the earlier round had {self.n_atoms}")
            products = gram.new_zeros(len(level), self.n_atoms)
            for slot in range(level.k):  # one after the other: the sums do not depend on threads
                products += weights[:, slot, None] * gram[atoms[:, slot]]
            norms = _sequential_sum(weights * products.gather(1, atoms)).clamp(min=0).sqrt()[:, None]
            tables.append(torch.where(norms > 0, products / norms.clamp(min=1e-12), 0.0))
        return tables

    def cosines(self, level: int, gaussian: Tensor, region: Tensor, table: Tensor) -> Tensor:
        """[T] float32: cosine of each pair's Gaussian and region; 1 where the Gaussian has no code.

        Args:
            level: position of the level.
            gaussian, region: [T] int64.
            table: [R, L] of the level, from ``region_cosines``.
        """
        found = table.new_zeros(len(gaussian))
        total = table.new_zeros(len(gaussian))
        for slot in range(self.indices.shape[2]):
            weights = self.weights[:, level, slot].to(table.device)[gaussian]
            atoms = self.indices[:, level, slot].to(table.device)[gaussian].long()
            found += weights * table[region, atoms]
            total += weights
        return torch.where(total > 0, found, 1.0)

    def factors(self, gaussian: Tensor, key: Tensor, stride: int, codes: list[SparseCodes]) -> Tensor:
        """[T] float32: what the triplets (gaussian, key = level * stride + region) count."""
        out = torch.ones(len(gaussian), device=gaussian.device)
        for level, table in enumerate(self.region_cosines(codes)):
            chosen = (key >= level * stride) & (key < (level + 1) * stride)
            cosines = self.cosines(
                level, gaussian[chosen], key[chosen] - level * stride, table.to(gaussian.device)
            )
            sharpness = self.sharpness[level].to(gaussian.device)
            out[chosen] = torch.exp(sharpness * (cosines - 1).clamp(max=0)).clamp(min=LEAST_AGREEMENT)
        return out


def _scaled_to_unit_norm(indices: Tensor, weights: Tensor, grams: Tensor) -> Tensor:
    out = torch.empty(weights.shape, dtype=torch.float32, device=weights.device)
    count, levels, k = weights.shape
    for level in range(levels):
        gram = grams[level].flatten()
        for start in range(0, count, _ROWS_AT_A_TIME):
            rows = slice(start, start + _ROWS_AT_A_TIME)
            atoms, parts = indices[rows, level].long(), weights[rows, level].float()
            squared = parts.new_zeros(len(parts))
            for one in range(k):
                for other in range(k):
                    inner = gram[atoms[:, one] * grams.shape[1] + atoms[:, other]]
                    squared += parts[:, one] * parts[:, other] * inner
            norms = squared.clamp(min=0).sqrt()[:, None]
            out[rows, level] = torch.where(norms > 1e-6, parts / norms.clamp(min=1e-6), 0.0)
    return out


def _sequential_sum(values: Tensor) -> Tensor:
    """[R] sums of [R, K], one column after the other."""
    total = values.new_zeros(len(values))
    for column in values.unbind(1):
        total = total + column
    return total
