"""The artefact: a language field over the Gaussians of one scene, with its renders and its relevancy."""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from scoup import raster
from scoup.base.errors import GeometryMismatchError, InputError
from scoup.field.artefact import (
    FieldInfo,
    FieldParts,
    check_codes,
    field_damage_named,
    read_field,
    write_field,
)
from scoup.field.cosine_cache import CosineCache, FieldCodes
from scoup.field.relevancy import relevancy
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import cosines_from_codes
from scoup.scene.gaussians import Gaussians

GAUSSIANS_AT_A_TIME = 65536


class LanguageField:
    """Sparse codes of every Gaussian at every level, their codebook, and the geometry they belong to.

    Args:
        code_indices: [N, S, K] uint8 (uint16 beyond 256 atoms).
        code_weights: [N, S, K] float16; a Gaussian that paints no region has only zeros.
        codebook: [S, L, D] float32.
        info: levels, model, fingerprint, provenance.
        gaussians: the geometry; None loads it from ``geometry_path`` when first needed.
        geometry_path: the file with the geometry.
        cameras: of the views it was built from, so that it can be queried without its scene folder.

    Raises:
        InputError: shapes, dtypes or values do not fit together.
        GeometryMismatchError: ``gaussians`` are not those the field was built on.
    """

    def __init__(
        self,
        code_indices: Tensor,
        code_weights: Tensor,
        codebook: Tensor,
        info: FieldInfo,
        gaussians: Gaussians | None = None,
        geometry_path: Path | None = None,
        cameras: Cameras | None = None,
    ) -> None:
        code_weights = code_weights.to(torch.float16)
        check_codes(code_indices, code_weights, codebook, info)
        self.code_indices = code_indices
        self.code_weights = code_weights
        self.codebook = codebook
        self.info = info
        self.geometry_path = geometry_path
        self.cameras = cameras
        self._gaussians = None
        self._cosine_cache = CosineCache()
        if gaussians is not None:
            self.attach(gaussians)

    # ---- what it is

    @property
    def levels(self) -> tuple[str, ...]:
        return self.info.levels

    @property
    def n_atoms(self) -> int:
        return self.codebook.shape[1]

    @property
    def dim(self) -> int:
        """D, the size of an embedding."""
        return self.codebook.shape[2]

    def __len__(self) -> int:
        return self.code_indices.shape[0]

    def to(self, device: torch.device | str) -> LanguageField:
        """The same field with its tensors, and its geometry if loaded, on a device; itself if it is there already."""
        place = torch.empty(0, device=device).device
        parts = [self.code_indices, self.code_weights, self.codebook]
        parts += [] if self._gaussians is None else [self._gaussians.means]
        if all(part.device == place for part in parts):
            return self
        moved = LanguageField(
            self.code_indices.to(device),
            self.code_weights.to(device),
            self.codebook.to(device),
            self.info,
            geometry_path=self.geometry_path,
            cameras=self.cameras,
        )
        moved._gaussians = None if self._gaussians is None else self._gaussians.to(device)
        return moved

    def coded(self) -> Tensor:
        """Boolean [N]: Gaussians with a code at any level."""
        return (self.code_weights > 0).flatten(1).any(1)

    @property
    def has_geometry(self) -> bool:
        """Whether the geometry is in memory: given, embedded in the file, or loaded before."""
        return self._gaussians is not None

    @property
    def gaussians(self) -> Gaussians:
        """The geometry, loaded on first use.

        Raises:
            GeometryMismatchError: the file holds other Gaussians than the field was built on.
            InputError: the field does not say where its geometry is.
        """
        if self._gaussians is None:
            if self.geometry_path is None:
                raise InputError(
                    "this field does not say where its Gaussians are; pass them: LanguageField.load(path, gaussians)"
                )
            from scoup.io import load_gaussians

            self.attach(load_gaussians(self.geometry_path).to(self.codebook.device), str(self.geometry_path))
        assert self._gaussians is not None
        return self._gaussians

    def attach(self, gaussians: Gaussians, source: str = "the Gaussians given", known: bool = False) -> None:
        """Use this geometry, after checking that it is the right one; ``known`` says that it is.

        Raises:
            GeometryMismatchError: it is not.
        """
        as_many = len(gaussians) == self.info.n_gaussians
        if not as_many or (not known and gaussians.fingerprint() != self.info.fingerprint):
            difference = "as many Gaussians, but others"
            if not as_many:
                difference = f"{len(gaussians)} Gaussians, the field has {self.info.n_gaussians}"
            raise GeometryMismatchError(
                f"{source}: not the geometry this field was built on ({difference}); "
                "give the original splat, or build the field again"
            )
        self._gaussians = gaussians

    # ---- renders and relevancy

    def project(self, camera: Camera, backend: str | None = None) -> raster.Projection:
        """The scene projected to a camera; pass it to the methods below to do several things with one camera.

        The first ``relevancy`` with it takes longest: for as long as the projection lives, the field keeps what further
        queries reuse (``scoup.field.cosine_cache``), 8 bytes a pixel and level.
        """
        return raster.project(self.gaussians, camera, self.info.raster_preset, backend)

    def is_visible(self, projection: raster.Projection) -> bool:
        """Whether a Gaussian with a code paints any pixel."""
        image, _ = raster.render_channels(projection, self.coded()[:, None].float())
        return bool(image.any())

    def render_codes(self, camera: Camera, projection: raster.Projection | None = None) -> Tensor:
        """[S, H, W, L] float32 rendered coefficients of every level."""
        projection = self.project(camera) if projection is None else projection
        return raster.render_codes(projection, self.code_indices, self.code_weights, self.n_atoms)

    def render_features(
        self, camera: Camera, level: str | int, projection: raster.Projection | None = None
    ) -> Tensor:
        """[H, W, D] float32 decoded features of one level, unit norm per pixel, zero where nothing is rendered."""
        index = self.level_index(level)
        projection = self.project(camera) if projection is None else projection
        chosen = slice(index, index + 1)
        indices, weights = self.code_indices[:, chosen], self.code_weights[:, chosen]
        return raster.render_features(projection, indices, weights, self.codebook[chosen])[0]

    def relevancy(
        self,
        camera: Camera,
        queries: Tensor,
        canonical: Tensor,
        projection: raster.Projection | None = None,
    ) -> Tensor:
        """Relevancy of every pixel to every query at every level (method.md, stage 3).

        Another query with the same ``projection`` takes less time: the norms of its pixels and the canonical phrases'
        largest cosine are known by then. Results differ from those of a fresh projection by rounding, about 1e-6.

        Args:
            camera: of the view.
            queries: [Q, D] unit-norm text embeddings.
            canonical: [P, D] unit-norm embeddings of the canonical phrases.
            projection: what ``project`` gave for this camera, if it is known; keep it for further queries.

        Returns:
            [S, Q, H, W] float32 in 0..1; 0.5 where no code is rendered.

        Raises:
            InputError: there is no query or no phrase, or they have another size than the field's embeddings.
        """
        both = self._checked_vectors(queries, canonical)
        codes = FieldCodes(self.code_indices, self.code_weights, self.codebook)
        if projection is None:
            cosines = raster.render_cosines(
                self.project(camera), codes.indices, codes.weights, codes.codebook, both
            )
            return relevancy(cosines[:, : len(queries)], cosines[:, len(queries) :])
        return self._cosine_cache.relevancy(projection, codes, both[: len(queries)], both[len(queries) :])

    def gaussian_relevancy(self, queries: Tensor, canonical: Tensor) -> Tensor:
        """Relevancy of every Gaussian's own code, without rendering: [S, Q, N] float32; 0.5 without a code.

        Raises:
            InputError: as ``relevancy``.
        """
        both, count = self._checked_vectors(queries, canonical), len(queries)
        out = torch.empty(len(self.levels), count, len(self), device=both.device)
        for start in range(0, len(self), GAUSSIANS_AT_A_TIME):
            rows = slice(start, start + GAUSSIANS_AT_A_TIME)
            for level, atoms in enumerate(self.codebook):
                indices, weights = self.code_indices[rows, level].long(), self.code_weights[rows, level]
                dense = torch.zeros(len(indices), self.n_atoms, device=both.device)
                dense.scatter_add_(1, indices, weights.float())
                cosines = cosines_from_codes(dense, atoms, both).T[None]
                out[level, :, rows] = relevancy(cosines[:, :count], cosines[:, count:])[0]
        return out

    def level_index(self, level: str | int) -> int:
        """Position of a level given by name or position."""
        if isinstance(level, int):
            if not 0 <= level < len(self.levels):
                raise InputError(f"there is no level {level}; levels: {', '.join(self.levels)}")
            return level
        if level not in self.levels:
            raise InputError(f"there is no level {level!r}; levels: {', '.join(self.levels)}")
        return self.levels.index(level)

    # ---- its file

    def save(
        self,
        path: str | Path,
        overwrite: bool = False,
        embed_geometry: bool = False,
        weight_bits: int = 16,
    ) -> None:
        """Write the field to one ``.scoup`` file (docs/formats.md), atomically.

        Args:
            path: the file.
            overwrite: replace what is there.
            embed_geometry: put the Gaussians into the file too.
            weight_bits: 16 (float16) or 8 (255 steps of each code's largest weight).

        Raises:
            OutputExistsError: the file is there and ``overwrite`` is false.
        """
        parts = FieldParts(
            self.code_indices,
            self.code_weights,
            self.codebook,
            self.info,
            self.gaussians if embed_geometry else None,
            self.geometry_path,
            self.cameras,
        )
        write_field(parts, Path(path), overwrite, weight_bits)

    @classmethod
    def load(cls, path: str | Path, gaussians: Gaussians | None = None) -> LanguageField:
        """Read a ``.scoup`` file.

        Args:
            path: the file.
            gaussians: its geometry; by default the one embedded or referenced, loaded when first needed.

        Raises:
            FileFormatError: the file is not a language field, or damaged.
            GeometryMismatchError: ``gaussians`` are not those it was built on.
        """
        path = Path(path)
        parts = read_field(path)
        with field_damage_named(path):
            codes = parts.code_indices, parts.code_weights, parts.codebook
            loaded = cls(*codes, parts.info, geometry_path=parts.geometry_path, cameras=parts.cameras)
        if gaussians is not None:
            loaded.attach(gaussians, f"{path} with the Gaussians given")
        elif parts.gaussians is not None:
            loaded.attach(parts.gaussians, f"{path}, the Gaussians embedded in it")
        return loaded

    def _checked_vectors(self, queries: Tensor, canonical: Tensor) -> Tensor:
        """Queries and phrases in one [Q + P, D] float32 on the field's device."""
        for name, vectors in (("queries", queries), ("canonical", canonical)):
            if vectors.dim() != 2 or vectors.shape[1] != self.dim or not len(vectors):
                raise InputError(
                    f"{name} {list(vectors.shape)} must be [count, {self.dim}]: this field holds embeddings of "
                    f"{self.info.embedding_model or 'an unnamed model'} with {self.dim} dimensions"
                )
        return torch.cat([queries, canonical]).float().to(self.codebook.device)
