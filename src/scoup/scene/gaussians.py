"""The trained scene: 3D Gaussians as plain tensors."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup.base import InputError, WorldFrame, geometry_fingerprint

MAX_SH_DEGREE = 4
TENSORS = ("means", "quats", "scales", "opacities", "sh")
FAINT = 0.1  # opacity below which a Gaussian is not in the picture of a notebook
SH_C0 = 0.28209479177387814  # the constant spherical harmonic: RGB = SH_C0 * sh[:, 0] + 0.5 at degree 0


@dataclass(frozen=True, eq=False)
class Gaussians:
    """N 3D Gaussians with activated values (docs/conventions.md); all float32, on one device.

    Rows that are not finite are allowed; the rasterisers never draw them. Numpy arrays are taken too, of any
    floating-point type.

    Raises:
        InputError: a shape, dtype or device differs from the above.

    Example:
        >>> gaussians = scoup.load_gaussians("scene/point_cloud.ply")
        >>> near = gaussians.select(gaussians.means.norm(dim=1) < 1.0)
        >>> len(near) < len(gaussians)
        True
    """

    means: Tensor
    """[N, 3] centres in world units."""
    quats: Tensor
    """[N, 4] rotations (w, x, y, z), unit norm."""
    scales: Tensor
    """[N, 3] standard deviations along the rotated axes, in world units (linear, not log)."""
    opacities: Tensor
    """[N] peak alpha, 0..1 (not logit). Values above 1 count as 1 when rasterised."""
    sh: Tensor
    """[N, B, 3] spherical-harmonic colour coefficients, B = (degree + 1)^2; RGB = max(0, SH + 0.5)."""
    antialiased: bool = field(default=False, kw_only=True)
    """Trained to be rasterised with compensated opacities (Mip-Splatting; ``rasterize_mode`` of gsplat)."""
    source_rows: Tensor | None = field(default=None, kw_only=True)
    """[R] bool: the rows of the file that these are, where a reader dropped some; None for all."""
    world: WorldFrame = field(default_factory=WorldFrame, kw_only=True)
    """Of the file, if its format has one, or of the field."""

    def __post_init__(self) -> None:
        for name, value in self.tensors().items():
            if isinstance(value, np.ndarray):
                object.__setattr__(self, name, torch.from_numpy(np.asarray(value, np.float32)))
        count = self.means.shape[0] if self.means.dim() else -1
        expected = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,)}
        for name, shape in expected.items():
            actual = tuple(getattr(self, name).shape)
            if actual != shape:
                raise InputError(f"Gaussians.{name} has shape {list(actual)}, expected {list(shape)}")
        bases = {(degree + 1) ** 2 for degree in range(MAX_SH_DEGREE + 1)}
        if (
            self.sh.dim() != 3
            or self.sh.shape[0] != count
            or self.sh.shape[2] != 3
            or self.sh.shape[1] not in bases
        ):
            raise InputError(
                f"Gaussians.sh has shape {list(self.sh.shape)}, expected [{count}, B, 3] with B in {sorted(bases)}"
            )
        for name, tensor in self.tensors().items():
            if tensor.dtype != torch.float32:
                raise InputError(f"Gaussians.{name} is {tensor.dtype}, expected torch.float32")
            if tensor.device != self.means.device:
                raise InputError(f"Gaussians.{name} is on {tensor.device}, means on {self.means.device}")

    def tensors(self) -> dict[str, Tensor]:
        """Return the tensors by their names."""
        return {name: getattr(self, name) for name in TENSORS}

    def __len__(self) -> int:
        return self.means.shape[0]

    @property
    def device(self) -> torch.device:
        return self.means.device

    @property
    def sh_degree(self) -> int:
        return round(self.sh.shape[1] ** 0.5) - 1

    def to(self, device: torch.device | str) -> Gaussians:
        return replace(self, **{name: tensor.to(device) for name, tensor in self.tensors().items()})

    def select(self, chosen: Tensor | ArrayLike | slice) -> Gaussians:
        """Return the Gaussians of a boolean mask [N], or of indices [M] in their order.

        Raises:
            InputError: as ``chosen_rows``.
        """
        chosen = chosen_rows(chosen, len(self)).to(self.device)
        chosen_tensors = {name: tensor[chosen] for name, tensor in self.tensors().items()}
        return replace(self, **chosen_tensors, source_rows=None)

    def __repr__(self) -> str:
        return f"Gaussians({len(self):,}, SH degree {self.sh_degree}, {self.device})"

    def _repr_html_(self) -> str:
        from scoup.base import card
        from scoup.scene.previews import points_preview

        means = self.means[self.finite()]
        facts: dict[str, str] = {"SH degree": str(self.sh_degree), "device": str(self.device)}
        if len(means):
            facts["extent"] = " x ".join(f"{side:.3g}" for side in (means.amax(0) - means.amin(0)).tolist())
        shown = self.finite() & (self.opacities > FAINT)
        colors = (SH_C0 * self.sh[shown, 0] + 0.5).clamp(0, 1)
        return card(f"{len(self):,} Gaussians", facts, points_preview(self.means[shown], colors))

    def finite(self) -> Tensor:
        """Return boolean [N]: rows whose means, quats, scales and opacities are all finite (opacity may be +inf)."""
        rows = torch.isfinite(self.means).all(1) & torch.isfinite(self.quats).all(1)
        rows &= torch.isfinite(self.scales).all(1)
        return rows & ~torch.isnan(self.opacities) & (self.opacities != -torch.inf)

    def fingerprint(self) -> str:
        """Return the SHA-256 of means, quats, scales and opacities, which decide all blending weights."""
        columns = (self.means, self.quats, self.scales, self.opacities)
        return geometry_fingerprint(*(column.detach().cpu().numpy() for column in columns))


def chosen_rows(chosen: Tensor | ArrayLike | slice, count: int) -> Tensor:
    """Return a choice of ``count`` rows as a boolean mask [count] or int64 indices [M]. It may be a tensor, an array or
    a list of these, with indices of any integer type, or a slice."""
    try:
        rows = torch.arange(count)[chosen] if isinstance(chosen, slice) else torch.as_tensor(chosen)
    except (TypeError, ValueError, RuntimeError):
        rows = torch.zeros(())
    is_integer = not (rows.is_floating_point() or rows.is_complex())
    if rows.dim() != 1 or not (is_integer or not len(rows)):
        raise InputError(f"Gaussians are chosen by a boolean mask [{count}], by indices [M] or by a slice")
    if rows.dtype == torch.bool and len(rows) != count:
        raise InputError(f"a mask of {len(rows)} does not choose among {count} Gaussians")
    if rows.dtype == torch.bool:
        return rows
    rows = rows.to(torch.int64)
    if len(rows) and not (int(rows.min()) >= 0 and int(rows.max()) < count):
        raise InputError(
            f"indices {int(rows.min())} to {int(rows.max())} are not all among {count} Gaussians"
        )
    return rows
