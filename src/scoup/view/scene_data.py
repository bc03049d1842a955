"""The file from which the page shows a field: splat, codes, cameras.

Gzipped safetensors with JSON under ``scoup`` in the metadata; an exported page contains it as base64. Arrays run over
components first; N Gaussians are shown, in Morton order.

- means [3, 3, N] uint8: byte (most significant first), axis, Gaussian; 24-bit fractions from means_low to means_high.
- scales [3, N] uint8: logarithms, 255ths between scales_low and scales_high. quats [4, N] int8, not normalised.
- colors [3, N], opacities [N], confidence [S, N] uint8: 255ths.
- code_indices [S, K, N]. code_weights [S, K, N] uint16: 65535ths of weights_scale, divided by the norm of the decoded
  code, so that their sum with the scores of a text's atoms is the cosine.
- owners [S, N] uint16: things; absent in a field without things.
- canonical [S, P, L] float32: scores of the canonical phrases, if texts can be asked.
- code_colors [S, 3, L], code_color_offsets [S, 3] float32: a code's colour is 0.08 + 0.9 times the offset plus the sum
  over its atoms, cut to 0..1.

A large scene comes in parts: the metadata of the first file add ``parts``, the numbers of merged Gaussians part by
part, and ``most``, the most Gaussians that whole parts may have together. The file of a part has the tensors of N
Gaussians, with a version and ranges of its own.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.field import NO_THING, Field
from scoup.pictures import code_basis
from scoup.query import placed_atoms
from scoup.scene import SH_C0, Cameras, Gaussians, SparseCodes, signed
from scoup.view.decimation import PageGaussians
from scoup.view.packing import byte_planes, fine_fractions, fractions, packed

VERSION = 1
_SCALE_SHARES = (0.0005, 0.9995)  # smaller scales than the first count as it
_LARGER = 6.0  # logarithm of how much larger than the second a scale may be
_CODES_FOR_COLORS = 50_000
_FOR_SURROUNDINGS = 100_000  # Gaussians sampled for the medians of all
NO_OWNER = 65535
"""In the place of the number of a thing."""


@dataclass(frozen=True, eq=False)
class UnitCodes:
    """Codes whose decoded features have norm 1. Tensors are on the CPU.

    The cosine of a Gaussian with a text is (w A) / sqrt(w G w^T) with A = C T^T and G = C C^T (method.md, stage 3).
    The divisor does not depend on the text: it is taken out of the weights once.
    """

    indices: Tensor  # [N, S, K] as in the field
    weights: (
        Tensor  # [N, S, K] float32, divided by the norm of the decoded code; zeros where there is no code
    )
    confidence: Tensor  # [N, S] float32
    """0 to 1, norm of the decoded code when its weights sum to 1: 1 where all regions that voted for the Gaussian have
    one embedding, and less the more they differ; 0 where there is no code."""

    @classmethod
    def of(cls, field: Field, rows: Tensor | slice = slice(None)) -> UnitCodes:
        """Return the unit codes of a field, or of some rows of it, on the CPU."""
        codes = field.codes.cpu().rows(rows)
        weights, inverse_norms = codes.weights.float(), codes.inverse_norms()
        lengths = weights.sum(-1) * inverse_norms
        confidence = torch.where(lengths > 0, 1 / lengths, 0.0).clamp(0, 1)
        unit = weights * inverse_norms[..., None]
        return cls(codes.indices, unit, confidence)

    def __len__(self) -> int:
        return len(self.indices)


def atom_scores(field: Field, vectors: Tensor) -> Tensor:
    """Return [S, L, Q] float32 on the CPU: inner products A = C T^T of the codebooks and text vectors [Q, D]."""
    return field.codebook.float().cpu() @ vectors.float().cpu().T


def scene_metadata(
    field: Field, name: str, words_problem: str | None, present_from: float | None
) -> dict[str, Any]:
    """Return the metadata of a field for the page as plain JSON values; None for ``present_from``, the score from which
    a text counts as present: presence is not judged."""
    up = field.up()
    centre, radius = surroundings(field.gaussians, field.cameras)
    model = field.embedding_model
    return {
        "version": VERSION,
        "name": name,
        "n_gaussians": len(field),
        "levels": list(field.levels),
        "n_atoms": field.n_atoms,
        "up": up.tolist(),
        "metres_per_unit": field.world.metres_per_unit,
        "centre": centre,
        "radius": radius,
        # The name only: the folders of this machine mean nothing elsewhere.
        "embedding_model": Path(model).name if Path(model).is_absolute() else model,
        "words_problem": words_problem,
        "present_from": present_from,
        "cameras": [
            {
                "name": camera.name,
                "viewmat": camera.viewmat.flatten().tolist(),
                "K": camera.K.flatten().tolist(),
                "width": camera.width,
                "height": camera.height,
            }
            for camera in field.cameras or ()
        ],
        **({} if field.thing_table is None else {"n_things": len(field.thing_table)}),
    }


def scene_data(
    field: Field,
    shown: PageGaussians,
    canonical: Tensor | None,  # [S, L, P] scores of the canonical phrases; None if no text can be asked
    metadata: dict[str, Any],
    effort: int,  # of compression, 1 to 9
) -> bytes:
    """Return the file that the page loads first."""
    codes = UnitCodes.of(field, shown.rows)
    tensors, ranges = _rows(field, shown, codes)
    tensors |= _code_colors(field, codes)
    if canonical is not None:
        tensors["canonical"] = canonical.permute(0, 2, 1).numpy()
    return packed(tensors, {**metadata, **ranges}, effort)


def part_data(field: Field, shown: PageGaussians, effort: int) -> bytes:
    """Return the file of a part of the scene, which the page loads later; arguments as for ``scene_data``."""
    tensors, ranges = _rows(field, shown, UnitCodes.of(field, shown.rows))
    return packed(tensors, {"version": VERSION, **ranges}, effort)


def _rows(
    field: Field, shown: PageGaussians, codes: UnitCodes
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays of a file, per Gaussian, and the ranges of its fractions."""
    largest = float(codes.weights.max()) if codes.weights.numel() else 0.0
    tensors, ranges = _splat(shown.gaussians)
    tensors |= {
        "code_indices": signed(codes.indices).permute(1, 2, 0).view(codes.indices.dtype).numpy(),
        "code_weights": fine_fractions(codes.weights.permute(1, 2, 0).numpy(), largest),
        "confidence": fractions(codes.confidence.T.numpy(), 0.0, 1.0),
    }
    if field.thing_table is not None:
        owners = field.thing_table.owners.cpu()[shown.rows].T.numpy()
        tensors["owners"] = np.where(owners == NO_THING, NO_OWNER, owners).astype(np.uint16)
    return tensors, {**ranges, "weights_scale": largest}


def surroundings(gaussians: Gaussians, cameras: Cameras | None) -> tuple[list[float], float]:
    """Return the point that the cameras look at, and how far they are from it.

    The point is the one nearest to all view axes. Without cameras, or if their axes are parallel, it is the median of
    the means, and the distance twice the median distance from it.
    """
    some = gaussians.select(slice(None, None, max(1, len(gaussians) // _FOR_SURROUNDINGS)))
    rows = some.finite()
    finite, scales = some.means[rows].cpu(), some.scales[rows].cpu()
    middle = finite.median(0).values.double() if len(finite) else torch.zeros(3, dtype=torch.float64)
    around = float((finite - middle.float()).norm(dim=1).median()) if len(finite) else 1.0
    # Cameras that turn on the spot are hardly apart, and a single Gaussian has no extent.
    least = max(0.1 * around, float(scales.amax(1).median()) if len(finite) else 0.0) or 1e-6
    if cameras is None or not len(cameras):
        return middle.tolist(), max(2 * around, least)
    places = torch.stack([camera.position for camera in cameras])
    axes = torch.stack([camera.viewmat[2, :3] for camera in cameras])
    across = torch.eye(3, dtype=torch.float64) - axes[:, :, None] * axes[:, None, :]  # [V, 3, 3]
    matrix, right = across.sum(0), (across @ places[:, :, None]).sum(0)[:, 0]
    centre = middle
    if float(torch.linalg.eigvalsh(matrix)[0]) > 1e-3 * len(places):
        centre = torch.linalg.solve(matrix, right)
    radius = float((places - centre).norm(dim=1).median())
    return centre.tolist(), max(radius, least)


def _splat(gaussians: Gaussians) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return arrays of the Gaussians, and the ranges they are fractions of."""
    means, low, high = byte_planes(gaussians.means.double().numpy())
    logarithms = gaussians.scales.double().clamp(min=1e-30).log().numpy()
    ends = np.quantile(logarithms, _SCALE_SHARES) if logarithms.size else np.zeros(2)
    ends[1] = min(logarithms.max(initial=ends[1]), ends[1] + _LARGER)
    quats = gaussians.quats.double()
    quats = quats / quats.abs().amax(1, keepdim=True).clamp(min=1e-12)
    colors = (SH_C0 * gaussians.sh[:, 0] + 0.5).nan_to_num(0).numpy()
    tensors = {
        "means": means,
        "scales": fractions(logarithms.T, float(ends[0]), float(ends[1])),
        "quats": np.rint(quats.T.numpy() * 127).astype(np.int8),
        "colors": fractions(colors.T, 0.0, 1.0),
        "opacities": fractions(gaussians.opacities.numpy(), 0.0, 1.0),
    }
    ranges = {
        "means_low": low,
        "means_high": high,
        "scales_low": float(ends[0]),
        "scales_high": float(ends[1]),
    }
    return tensors, ranges


def _code_colors(field: Field, codes: UnitCodes) -> dict[str, NDArray[np.float32]]:
    """Return a colour for each atom, [S, 3, L], whose weighted sum and offset [S, 3] is that of a code: like meaning,
    like colour, as in ``scoup.query.drawings.code_drawing``."""
    step = max(1, math.ceil(len(codes) / _CODES_FOR_COLORS))
    colors, offsets = [], []
    for level, atoms in enumerate(field.codebook.float().cpu()):
        placed = placed_atoms(atoms)  # [L, axes]
        sample = SparseCodes(codes.indices[::step, level], codes.weights[::step, level], field.n_atoms)
        affine, (low, high) = code_basis(sample.to_dense() @ placed)
        colors.append((placed.double().numpy() @ affine[:-1] / (high - low)).T)
        offsets.append((affine[-1] - low) / (high - low))
    stacked = {"code_colors": np.stack(colors), "code_color_offsets": np.stack(offsets)}
    return {name: array.astype(np.float32) for name, array in stacked.items()}
