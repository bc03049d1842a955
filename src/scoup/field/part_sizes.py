"""Bytes of a ``.scoup`` file: of the codes, which grow with the scene, and of the codebook, which does not."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path


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

    @property
    def codes_a_gaussian(self) -> float:
        return self.codes / max(1, self.gaussians)

    def __str__(self) -> str:
        owners = f" and {self.owners / max(1, self.gaussians):.0f} of things" if self.owners else ""
        codebook = f"a codebook of {self.codebook / 1e3:,.0f} kB"
        return f"{self.codes_a_gaussian:.0f} bytes of codes{owners} a Gaussian, {codebook}"


def part_sizes(path: Path) -> PartSizes:
    """Return the sizes of a file that ``LanguageField.load`` reads, from its header alone."""
    with open(path, "rb") as stream:
        header = json.loads(stream.read(int.from_bytes(stream.read(8), "little")))
    sizes: dict[str, int] = {}
    for name, entry in header.items():
        if name != "__metadata__":
            start, end = entry["data_offsets"]
            part = name.split(".")[0]
            sizes[part] = sizes.get(part, 0) + end - start
    codes = sizes["code_indices"] + sizes["code_weights"]
    start, end = header["things.owners"]["data_offsets"] if "things.owners" in header else (0, 0)
    count = header["code_indices"]["shape"][0]
    return PartSizes(count, codes, sizes["codebook"], sizes.get("geometry", 0), end - start)
