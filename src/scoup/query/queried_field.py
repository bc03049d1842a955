"""What a language field offers to those who query it."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol

from torch import Tensor

from scoup import raster
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians


class QueriedField(Protocol):
    """A field as its queries see it; ``scoup.field.language_field.LanguageField`` is one.

    Attributes:
        code_indices, code_weights: [N, S, K] the codes of N Gaussians at S levels.
        codebook: [S, L, D].
        geometry_path: file of the Gaussians, if the field names one.
        cameras: of the views it was built from, if it holds them.
    """

    code_indices: Tensor  # [N, S, K]
    code_weights: Tensor  # [N, S, K]
    codebook: Tensor  # [S, L, D]
    geometry_path: Path | None
    cameras: Cameras | None

    def __len__(self) -> int: ...
    @property
    def levels(self) -> tuple[str, ...]: ...
    @property
    def n_atoms(self) -> int: ...
    @property
    def dim(self) -> int: ...
    @property
    def embedding_model(self) -> str: ...
    @property
    def encoder_source(self) -> str: ...
    @property
    def fingerprint(self) -> str: ...
    @property
    def gaussians(self) -> Gaussians: ...
    def level_index(self, level: str | int) -> int: ...
    def camera(self, camera: Camera | str | int) -> Camera: ...
    def project(self, camera: Camera | str | int, backend: str | None = None) -> raster.Projection: ...
    def render_codes(
        self, camera: Camera | str | int, projection: raster.Projection | None = None
    ) -> Tensor: ...
    def relevancy(
        self,
        camera: Camera | str | int,
        queries: Tensor,
        canonical: Tensor,
        projection: raster.Projection | None = None,
    ) -> Tensor: ...
    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor: ...
