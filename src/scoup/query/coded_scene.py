"""A scene whose Gaussians have codes: its geometry, its renders, and its relevancy to vectors."""

from __future__ import annotations

from numbers import Integral
from pathlib import Path
from typing import Any

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.base.counts import counted
from scoup.base.errors import GeometryMismatchError, InputError
from scoup.query.cosines import FieldCodes, FieldCosines
from scoup.query.recent import Recent
from scoup.query.relevancy import relevancy
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.directions import query_vectors
from scoup.scene.field_info import FieldInfo, check_codes, check_things
from scoup.scene.gaussians import Gaussians
from scoup.scene.things import ThingTable

GAUSSIANS_AT_A_TIME = 65536
MOST_KEPT, MOST_BYTES = 512, 64 << 20
"""A field keeps so many of the last questions and of its answers to them, together."""


class CodedScene:
    """Sparse codes of every Gaussian at every level, their codebook, and the geometry they belong to.

    Args:
        code_indices: [N, S, K] uint8 (uint16 beyond 256 atoms).
        code_weights: [N, S, K] float16; a Gaussian that contributes to no region has only zeros.
        codebook: [S, L, D] float32.
        info: levels, model, fingerprint, provenance.
        gaussians: the geometry; None loads it from ``geometry_path`` when first needed.
        geometry_path: the file with the geometry.
        cameras: of the views it was built from, so that it can be queried without its scene folder.
        thing_table: instances of the scene; None where none are known, and the votes of the Gaussians answer alone.

    Codes and codebook may be given as numpy arrays.

    Attributes:
        path: the file it was read from or last saved to, if any.

    Raises:
        InputError: shapes, dtypes or values do not fit together.
        GeometryMismatchError: ``gaussians`` are not those the codes were made for.
    """

    def __init__(
        self,
        code_indices: Tensor | ArrayLike,
        code_weights: Tensor | ArrayLike,
        codebook: Tensor | ArrayLike,
        info: FieldInfo,
        gaussians: Gaussians | None = None,
        geometry_path: Path | None = None,
        cameras: Cameras | None = None,
        thing_table: ThingTable | None = None,
    ) -> None:
        code_indices, codebook = torch.as_tensor(code_indices), torch.as_tensor(codebook)
        code_weights = torch.as_tensor(code_weights).to(torch.float16)
        check_codes(code_indices, code_weights, codebook, info)
        if thing_table is not None:
            check_things(thing_table, code_indices.shape, codebook.shape[2])
        self.code_indices = code_indices
        self.code_weights = code_weights
        self.codebook = codebook
        self.info = info
        self.geometry_path = geometry_path
        self.cameras = cameras
        self.thing_table = thing_table
        self.path: Path | None = None
        self._gaussians = None
        self._cosines = FieldCosines()
        self._known = Recent(MOST_KEPT, MOST_BYTES)
        if gaussians is not None:
            self.attach(gaussians)

    # ---- what it is

    @property
    def levels(self) -> tuple[str, ...]:
        return self.info.levels

    @property
    def embedding_model(self) -> str:
        """Id of the model, or file of the word table, that queries must come from; "" if it is not known."""
        return self.info.embedding_model

    @property
    def fingerprint(self) -> str:
        """Of the geometry the codes belong to (``Gaussians.fingerprint``)."""
        return self.info.fingerprint

    @property
    def raster_preset(self) -> str:
        """The rasteriser's constants that the field was built with and is rendered with."""
        return self.info.raster_preset

    @property
    def n_atoms(self) -> int:
        return self.codebook.shape[1]

    @property
    def dim(self) -> int:
        """D, the size of an embedding."""
        return self.codebook.shape[2]

    def __len__(self) -> int:
        return self.code_indices.shape[0]

    def coded(self) -> Tensor:
        """Boolean [N]: Gaussians with a code at any level."""
        return (self.code_weights > 0).flatten(1).any(1)

    def coded_levels(self) -> Tensor:
        """Boolean [S, N]: Gaussians with a code at each level; not to be changed."""
        return self._cosines.coded(self._codes())

    def _parts(self) -> list[Any]:
        """What answers depend on."""
        known = self._gaussians
        geometry = () if known is None else (known.means, known.scales, known.opacities)
        return [self.code_indices, self.code_weights, self.codebook, self.thing_table, *geometry]

    def _codes(self) -> FieldCodes:
        return FieldCodes(self.code_indices, self.code_weights, self.codebook)

    def level_index(self, level: str | int) -> int:
        """Position of a level given by name or position."""
        if isinstance(level, int):
            if not 0 <= level < len(self.levels):
                raise InputError(f"there is no level {level}; levels: {', '.join(self.levels)}")
            return level
        if level not in self.levels:
            raise InputError(f"there is no level {level!r}; levels: {', '.join(self.levels)}")
        return self.levels.index(level)

    # ---- geometry and cameras

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
                which = self.path or "this field"
                raise InputError(
                    f"{which}: does not say where its Gaussians are; pass them: LanguageField.load(path, gaussians)"
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
        check_arguments("LanguageField.attach", gaussians=(gaussians, Gaussians))
        as_many = len(gaussians) == self.info.n_gaussians
        if not as_many or (not known and gaussians.fingerprint() != self.info.fingerprint):
            difference = "as many Gaussians, but others"
            if not as_many:
                difference = f"{counted(len(gaussians), 'Gaussian')}, the field has {self.info.n_gaussians:,}"
            raise GeometryMismatchError(
                f"{source}: not the geometry this field was built on ({difference}); "
                "give the original splat, or build the field again"
            )
        self._gaussians = gaussians

    def camera(self, camera: Camera | str | int) -> Camera:
        """A camera by its name (with or without extension) or position among ``cameras``; a camera is itself.

        Raises:
            UnknownNameError: there is no camera of that name.
            InputError: there are no cameras, or fewer.
        """
        check_arguments("LanguageField.camera", camera=(camera, (Camera, str, Integral)))
        if isinstance(camera, Camera):
            return camera
        if self.cameras is None or not len(self.cameras):
            raise InputError(
                "this field holds no cameras; give a Camera (scoup.load_cameras reads those of a scene)"
            )
        try:
            return self.cameras[camera]
        except IndexError:
            raise InputError(f"there is no camera {camera}; this field has {len(self.cameras)}") from None

    # ---- renders and relevancy

    def project(self, camera: Camera | str | int, backend: str | None = None) -> raster.Projection:
        """The scene projected to a camera; pass it to the methods below to do several things with one camera.

        The first ``relevancy`` with it takes longest: for as long as the projection lives, the field keeps what further
        queries reuse (``scoup.query.cosines``), 8 bytes a pixel and level.
        """
        return raster.project(self.gaussians, self.camera(camera), self.raster_preset, backend)

    def is_visible(self, projection: raster.Projection) -> bool:
        """Whether a Gaussian with a code contributes to any pixel."""
        image, _ = raster.render_channels(projection, self.coded()[:, None].float())
        return bool(image.any())

    def render_codes(self, camera: Camera | str | int, projection: raster.Projection | None = None) -> Tensor:
        """[S, H, W, L] float32 rendered coefficients of every level."""
        projection = self.project(camera) if projection is None else projection
        return raster.render_codes(projection, self.code_indices, self.code_weights, self.n_atoms)

    def render_features(
        self, camera: Camera | str | int, level: str | int, projection: raster.Projection | None = None
    ) -> Tensor:
        """[H, W, D] float32 decoded features of one level, unit norm per pixel, zero where nothing is rendered."""
        index = self.level_index(level)
        projection = self.project(camera) if projection is None else projection
        chosen = slice(index, index + 1)
        indices, weights = self.code_indices[:, chosen], self.code_weights[:, chosen]
        return raster.render_features(projection, indices, weights, self.codebook[chosen])[0]

    def relevancy(
        self,
        camera: Camera | str | int,
        queries: Tensor | ArrayLike,
        canonical: Tensor | ArrayLike,
        projection: raster.Projection | None = None,
    ) -> Tensor:
        """Relevancy of every pixel to every query at every level (method.md, stage 3).

        Another query with the same ``projection`` takes less time: the norms of its pixels and the canonical phrases'
        largest cosine are known by then. Results differ from those of a fresh projection by rounding, about 1e-6.

        Args:
            camera: of the view, or its name or position among ``cameras``.
            queries: [Q, D] or [D] text embeddings; scaled to unit norm.
            canonical: [P, D] embeddings of the canonical phrases. Rows longer than 1 are scaled to unit norm; shorter
                ones stay, as the mean of everyday words does (``scoup.models.words.with_everyday``).
            projection: what ``project`` gave for this camera, if it is known; keep it for further queries.

        Returns:
            [S, Q, H, W] float32 in 0..1; 0.5 where no code is rendered.

        Raises:
            InputError: there is no query or no phrase, one is zero or not finite, or they have another size than the
                field's embeddings.
        """
        both, count = self._checked_vectors(queries, canonical)
        codes = self._codes()
        if projection is None:
            cosines = raster.render_cosines(
                self.project(camera), codes.indices, codes.weights, codes.codebook, both
            )
            return relevancy(cosines[:, :count], cosines[:, count:])
        return self._cosines.of_pixels(projection, codes, both[:count], both[count:])

    def gaussian_relevancy(self, queries: Tensor | ArrayLike, canonical: Tensor | ArrayLike) -> Tensor:
        """Relevancy of every Gaussian's own code, without rendering: [S, Q, N] float32; 0.5 without a code.

        What depends on the codes and the phrases alone is kept for the next call.

        Args:
            queries, canonical: as for ``relevancy``.

        Raises:
            InputError: as ``relevancy``.
        """
        both, count = self._checked_vectors(queries, canonical)
        return self._cosines.of_gaussians(self._codes(), both[:count], both[count:])

    def gaussian_features(self, level: str | int) -> Tensor:
        """The decoded codes of all Gaussians at one level: [N, D] float32, unit norm; zero without a code.

        Raises:
            InputError: there is no such level.
        """
        index = self.level_index(level)
        out = torch.empty(len(self), self.dim, device=self.codebook.device)
        for start in range(0, len(self), GAUSSIANS_AT_A_TIME):
            rows = slice(start, start + GAUSSIANS_AT_A_TIME)
            indices, weights = self.code_indices[rows, index].long(), self.code_weights[rows, index]
            dense = torch.zeros(len(indices), self.n_atoms, device=self.codebook.device)
            dense.scatter_add_(1, indices, weights.float())
            out[rows] = torch.nn.functional.normalize(dense @ self.codebook[index], dim=1)
        return out

    def _checked_vectors(
        self, queries: Tensor | ArrayLike, canonical: Tensor | ArrayLike
    ) -> tuple[Tensor, int]:
        """Queries and phrases in one [Q + P, D] float32 on the field's device, and Q."""
        try:
            queries = query_vectors(queries, self.dim)
            canonical = query_vectors(canonical, self.dim, "canonical", lengthen=False)
        except InputError as error:
            raise InputError(
                f"{error}; this field holds embeddings of {self.embedding_model or 'an unnamed model'} with "
                f"{self.dim} dimensions"
            ) from error
        device = self.codebook.device
        return torch.cat([queries.to(device), canonical.to(device)]), len(queries)
