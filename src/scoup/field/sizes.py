"""Bytes of a ``.scoup`` file: of the codes, which grow with the scene, and of the codebook, which does not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from scoup.field.container import read_content


@dataclass(frozen=True)
class PartSizes:
    """Bytes of the parts of a language field's file.

    Attributes:
        gaussians: how many there are.
        codes: of all Gaussians at all levels.
        codebook: of all levels.
        geometry: of the embedded Gaussians; 0 for none.
        owners: of the numbers that say to which things the Gaussians belong; 0 for none.
    """

    gaussians: int
    codes: int
    codebook: int
    geometry: int
    owners: int = 0

    @classmethod
    def of(cls, arrays: Mapping[str, NDArray[Any]]) -> PartSizes:
        """Return the sizes of the tensors of a file."""
        codes = arrays["code_indices"].nbytes + arrays["code_weights"].nbytes
        geometry = sum(array.nbytes for name, array in arrays.items() if name.startswith("geometry."))
        owners = arrays["things.owners"].nbytes if "things.owners" in arrays else 0
        return cls(len(arrays["code_indices"]), codes, arrays["codebook"].nbytes, geometry, owners)

    @property
    def codes_a_gaussian(self) -> float:
        return self.codes / max(1, self.gaussians)

    def __str__(self) -> str:
        owners = f" and {self.owners / max(1, self.gaussians):.0f} of things" if self.owners else ""
        codebook = f"a codebook of {self.codebook / 1e3:,.0f} kB"
        return f"{self.codes_a_gaussian:.0f} bytes of codes{owners} a Gaussian, {codebook}"


def part_sizes(path: Path) -> PartSizes:
    """Return the sizes of the parts of a ``.scoup`` file."""
    return PartSizes.of(read_content(path)[1])
