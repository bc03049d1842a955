"""What a language field offers to those who query it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path

from torch import Tensor

from scoup import raster
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.things import Things


class QueriedField(ABC):
    """A field as its queries see it; ``scoup.field.language_field.LanguageField`` is the one, and says what each gives.

    Attributes:
        code_indices, code_weights: [N, S, K] the codes of N Gaussians at S levels.
        codebook: [S, L, D].
        geometry_path: file of the Gaussians, if the field names one.
        path: the file the field was read from or last saved to, if any.
        cameras: of the views it was built from, if it holds them.
        things: instances of the scene, if they are known.
    """

    code_indices: Tensor  # [N, S, K]
    code_weights: Tensor  # [N, S, K]
    codebook: Tensor  # [S, L, D]
    geometry_path: Path | None
    path: Path | None
    cameras: Cameras | None
    things: Things | None

    @abstractmethod
    def __len__(self) -> int: ...

    @property
    @abstractmethod
    def levels(self) -> tuple[str, ...]: ...

    @property
    @abstractmethod
    def n_atoms(self) -> int: ...

    @property
    @abstractmethod
    def dim(self) -> int: ...

    @property
    @abstractmethod
    def embedding_model(self) -> str: ...

    @property
    @abstractmethod
    def fingerprint(self) -> str: ...

    @property
    @abstractmethod
    def raster_preset(self) -> str: ...

    @property
    @abstractmethod
    def gaussians(self) -> Gaussians: ...

    @abstractmethod
    def level_index(self, level: str | int) -> int: ...

    @abstractmethod
    def camera(self, camera: Camera | str | int) -> Camera: ...

    @abstractmethod
    def project(self, camera: Camera | str | int, backend: str | None = None) -> raster.Projection: ...

    @abstractmethod
    def is_visible(self, projection: raster.Projection) -> bool: ...

    @abstractmethod
    def render_codes(
        self, camera: Camera | str | int, projection: raster.Projection | None = None
    ) -> Tensor: ...

    @abstractmethod
    def relevancy(
        self,
        camera: Camera | str | int,
        queries: Tensor,
        canonical: Tensor,
        projection: raster.Projection | None = None,
    ) -> Tensor: ...

    @abstractmethod
    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor: ...
