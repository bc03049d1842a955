"""A scene with coded Gaussians: its geometry, its renders, and its relevancy to vectors."""

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
from scoup.query.known_things import KnownThings
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
        code_weights: [N, S, K] float16; all zero for a Gaussian that contributes to no region.
        codebook: [S, L, D] float32.
        info: levels, model, fingerprint, provenance.
        gaussians: the geometry; None: loaded from ``geometry_path`` at first use.
        geometry_path: the file with the geometry.
        cameras: of the views it was built from.
        thing_table: instances of the scene; with None, the votes of the Gaussians answer alone.

    Codes and codebook may be numpy arrays.

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
        self.path: Path | None = None  # the file it was read from or last saved to
        self._gaussians = None
        self._cosines = FieldCosines()
        self.known_things = KnownThings()
        self.recent = Recent(MOST_KEPT, MOST_BYTES)
        if gaussians is not None:
            self.attach(gaussians)

    @property
    def levels(self) -> tuple[str, ...]:
        return self.info.levels

    @property
    def embedding_model(self) -> str:
        """Id of the model, or file of the word table, that encodes texts for it; "" if unknown."""
        return self.info.embedding_model

    @property
    def fingerprint(self) -> str:
        """Fingerprint of the geometry (``Gaussians.fingerprint``)."""
        return self.info.fingerprint

    @property
    def raster_preset(self) -> str:
        """The rasteriser's constants, for building and rendering."""
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
        """Return which Gaussians have a code at any level, boolean [N]."""
        return (self.code_weights > 0).flatten(1).any(1)

    def coded_levels(self) -> Tensor:
        """Return which Gaussians have a code at each level, boolean [S, N]; do not change it."""
        return self._cosines.coded(self._codes())

    def _parts(self) -> list[Any]:
        """The tensors that answers depend on."""
        known = self._gaussians
        geometry = () if known is None else (known.means, known.scales, known.opacities)
        return [self.code_indices, self.code_weights, self.codebook, self.thing_table, *geometry]

    def _codes(self) -> FieldCodes:
        return FieldCodes(self.code_indices, self.code_weights, self.codebook)

    def level_index(self, level: str | int) -> int:
        """Return the position of a level, given by name or position."""
        if isinstance(level, int):
            if not 0 <= level < len(self.levels):
                raise InputError(f"there is no level {level}; expected one of {', '.join(self.levels)}")
            return level
        if level not in self.levels:
            raise InputError(f"there is no level {level!r}; expected one of {', '.join(self.levels)}")
        return self.levels.index(level)

    @property
    def has_geometry(self) -> bool:
        """Return whether the geometry is in memory."""
        return self._gaussians is not None

    @property
    def gaussians(self) -> Gaussians:
        """The geometry, loaded on first use.

        Raises:
            GeometryMismatchError: the file contains other Gaussians than the field was built on.
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
        """Use this geometry.

        Args:
            gaussians: the geometry.
            source: its name in messages.
            known: do not compare fingerprints.

        Raises:
            GeometryMismatchError: the field was built on other Gaussians.
        """
        check_arguments("LanguageField.attach", gaussians=(gaussians, Gaussians))
        as_many = len(gaussians) == self.info.n_gaussians
        if not as_many or (not known and gaussians.fingerprint() != self.info.fingerprint):
            difference = "as many Gaussians, but others"
            if not as_many:
                difference = f"{counted(len(gaussians), 'Gaussian')}, the field has {self.info.n_gaussians:,}"
            raise GeometryMismatchError(
                f"{source}: not the geometry this field was built on ({difference}); "
                "pass the original splat, or build the field again"
            )
        self._gaussians = gaussians

    def camera(self, camera: Camera | str | int) -> Camera:
        """Return a camera by its name (with or without extension) or position among ``cameras``; or itself.

        Raises:
            UnknownNameError: there is no camera of that name.
            InputError: there are no cameras, or fewer.
        """
        check_arguments("LanguageField.camera", camera=(camera, (Camera, str, Integral)))
        if isinstance(camera, Camera):
            return camera
        if self.cameras is None or not len(self.cameras):
            raise InputError(
                "this field contains no cameras; pass a Camera (scoup.load_cameras reads those of a scene)"
            )
        try:
            return self.cameras[camera]
        except IndexError:
            raise InputError(f"there is no camera {camera}; this field has {len(self.cameras)}") from None

    def project(self, camera: Camera | str | int, backend: str | None = None) -> raster.Projection:
        """Project the scene to a camera; pass the result to the methods below to do several things with one camera.

        The first ``relevancy`` with it takes longest: while the projection lives, the field keeps what further queries
        reuse (``scoup.query.cosines``), 8 bytes per pixel and level.
        """
        return raster.project(self.gaussians, self.camera(camera), self.raster_preset, backend)

    def is_visible(self, projection: raster.Projection) -> bool:
        """Return whether a Gaussian with a code contributes to any pixel."""
        return bool(raster.render_values(projection, self.coded()[:, None].float()).any())

    def render_codes(self, camera: Camera | str | int, projection: raster.Projection | None = None) -> Tensor:
        """Render the coefficients of every level, [S, H, W, L] float32."""
        projection = self.project(camera) if projection is None else projection
        return raster.render_codes(projection, self.code_indices, self.code_weights, self.n_atoms)

    def render_features(
        self, camera: Camera | str | int, level: str | int, projection: raster.Projection | None = None
    ) -> Tensor:
        """Render decoded features of one level, [H, W, D] float32, unit norm or, where nothing is rendered, zero."""
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
        """Return the relevancy of every pixel to every query at every level (method.md, stage 3).

        Another query with the same ``projection`` takes less time (``project``) and differs from one with a fresh
        projection by rounding, about 1e-6.

        Args:
            camera: of the view, or its name or position among ``cameras``.
            queries: [Q, D] or [D] text embeddings; scaled to unit norm.
            canonical: [P, D] embeddings of the canonical phrases. Rows longer than 1 are scaled to unit norm; shorter
                ones stay, as the mean of everyday words does (``scoup.models.words.with_everyday``).
            projection: what ``project`` returned for this camera; keep it for further queries.

        Returns:
            [S, Q, H, W] float32 in 0..1; 0.5 where no code is rendered.

        Raises:
            InputError: there is no query or no phrase, or one is zero, not finite or not of the field's dimensions.
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
        """Return the relevancy of every Gaussian's own code, without rendering: [S, Q, N] float32; 0.5 without a code.

        Arguments and errors are those of ``relevancy``.
        """
        both, count = self._checked_vectors(queries, canonical)
        return self._cosines.of_gaussians(self._codes(), both[:count], both[count:])

    def gaussian_features(self, level: str | int) -> Tensor:
        """Return the decoded codes of all Gaussians at one level: [N, D] float32, unit norm; zero without a code.

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
        """Queries and phrases together, [Q + P, D] float32 on the field's device, and Q."""
        try:
            queries = query_vectors(queries, self.dim)
            canonical = query_vectors(canonical, self.dim, "canonical", lengthen=False)
        except InputError as error:
            raise InputError(
                f"{error}; this field contains embeddings of {self.embedding_model or 'an unnamed model'} with "
                f"{self.dim} dimensions"
            ) from error
        device = self.codebook.device
        return torch.cat([queries.to(device), canonical.to(device)]), len(queries)
