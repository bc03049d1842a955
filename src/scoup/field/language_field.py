"""The artefact: a language field over the Gaussians of one scene, with its renders and its relevancy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base.arguments import PATH, check_arguments
from scoup.base.counts import counted
from scoup.base.errors import GeometryMismatchError, InputError
from scoup.field.artefact import (
    FieldInfo,
    FieldParts,
    check_codes,
    check_things,
    field_damage_named,
    read_field,
    write_field,
)
from scoup.field.cosine_cache import CosineCache, FieldCodes
from scoup.query.methods import Encoder, FieldQueries
from scoup.query.relevancy import relevancy
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import cosines_from_codes, rows_of
from scoup.scene.directions import query_vectors
from scoup.scene.gaussians import Gaussians, chosen_rows
from scoup.scene.things import Things

if TYPE_CHECKING:
    from scoup.view.viewer import Viewer

GAUSSIANS_AT_A_TIME = 65536


class LanguageField(FieldQueries):
    """Sparse codes of every Gaussian at every level, their codebook, and the geometry they belong to.

    Args:
        code_indices: [N, S, K] uint8 (uint16 beyond 256 atoms).
        code_weights: [N, S, K] float16; a Gaussian that paints no region has only zeros.
        codebook: [S, L, D] float32.
        info: levels, model, fingerprint, provenance.
        gaussians: the geometry; None loads it from ``geometry_path`` when first needed.
        geometry_path: the file with the geometry.
        cameras: of the views it was built from, so that it can be queried without its scene folder.
        things: instances of the scene; None where none are known, and the votes of the Gaussians answer alone.

    Codes and codebook may be given as numpy arrays.

    Attributes:
        path: the file it was read from or last saved to, if any.

    Raises:
        InputError: shapes, dtypes or values do not fit together.
        GeometryMismatchError: ``gaussians`` are not those the field was built on.
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
        things: Things | None = None,
    ) -> None:
        code_indices, codebook = torch.as_tensor(code_indices), torch.as_tensor(codebook)
        code_weights = torch.as_tensor(code_weights).to(torch.float16)
        check_codes(code_indices, code_weights, codebook, info)
        if things is not None:
            check_things(things, code_indices.shape, codebook.shape[2])
        self.code_indices = code_indices
        self.code_weights = code_weights
        self.codebook = codebook
        self.info = info
        self.geometry_path = geometry_path
        self.cameras = cameras
        self.things = things
        self.path: Path | None = None
        self._gaussians = None
        self._cosine_cache = CosineCache()
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
        """Of the geometry the field belongs to (``Gaussians.fingerprint``)."""
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

    def __repr__(self) -> str:
        sizes = f"{self.n_atoms} atoms, {self.dim} dimensions of {self.embedding_model or 'an unnamed model'}"
        return f"LanguageField({len(self):,} Gaussians, levels {', '.join(self.levels)}, {sizes})"

    def _repr_html_(self) -> str:
        from scoup.query.field_card import field_card

        return field_card(self)

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
            things=None if self.things is None else self.things.to(device),
        )
        moved.path = self.path
        moved.keep_encoder_of(self)
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

    def select(self, chosen: Tensor | ArrayLike | slice) -> LanguageField:
        """The field of some of the Gaussians, to be queried and saved as any other; ``field[mask]`` is the same.

        Args:
            chosen: a boolean mask [N], indices [M] in the order wanted, or a slice.

        Returns:
            A field with a geometry of its own, which ``save`` embeds in the file. It has no region sums: to add or
            remove views, build it again.

        Raises:
            InputError: there is no such Gaussian, or the geometry cannot be loaded.
        """
        rows = chosen_rows(chosen, len(self)).to(self.codebook.device)
        things = None if self.things is None else self.things.rows(rows)
        gaussians = self.gaussians.select(chosen)
        return self._of(gaussians, rows_of(self.code_indices, rows), self.code_weights[rows], things)

    def with_gaussians(self, gaussians: Gaussians) -> LanguageField:
        """The same codes on other Gaussians, one for one: of a splat that was moved, recoloured or faded.

        Args:
            gaussians: as many as before, in the same order.

        Returns:
            A field with a geometry of its own, as ``select`` gives.

        Raises:
            InputError: there are more or fewer.
        """
        if len(gaussians) != len(self):
            raise InputError(f"{len(gaussians):,} Gaussians, but the field has codes of {len(self):,}")
        codes = self.code_indices, self.code_weights
        return self._of(gaussians.to(self.codebook.device), *codes, self.things)

    def _of(
        self, gaussians: Gaussians, indices: Tensor, weights: Tensor, things: Things | None
    ) -> LanguageField:
        """A field of these Gaussians and their codes, made from this one."""
        provenance = {**self.info.provenance, "selected_from": self.fingerprint}
        info = replace(
            self.info, fingerprint=gaussians.fingerprint(), n_gaussians=len(gaussians), provenance=provenance
        )
        made = LanguageField(indices, weights, self.codebook, info, cameras=self.cameras, things=things)
        made.attach(gaussians, known=True)
        made.keep_encoder_of(self)
        return made

    def __getitem__(self, chosen: Tensor | ArrayLike | slice) -> LanguageField:
        return self.select(chosen)

    # ---- renders and relevancy

    def project(self, camera: Camera | str | int, backend: str | None = None) -> raster.Projection:
        """The scene projected to a camera; pass it to the methods below to do several things with one camera.

        The first ``relevancy`` with it takes longest: for as long as the projection lives, the field keeps what further
        queries reuse (``scoup.field.cosine_cache``), 8 bytes a pixel and level.
        """
        return raster.project(self.gaussians, self.camera(camera), self.info.raster_preset, backend)

    def is_visible(self, projection: raster.Projection) -> bool:
        """Whether a Gaussian with a code paints any pixel."""
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
        codes = FieldCodes(self.code_indices, self.code_weights, self.codebook)
        if projection is None:
            cosines = raster.render_cosines(
                self.project(camera), codes.indices, codes.weights, codes.codebook, both
            )
            return relevancy(cosines[:, :count], cosines[:, count:])
        return self._cosine_cache.relevancy(projection, codes, both[:count], both[count:])

    def gaussian_relevancy(self, queries: Tensor | ArrayLike, canonical: Tensor | ArrayLike) -> Tensor:
        """Relevancy of every Gaussian's own code, without rendering: [S, Q, N] float32; 0.5 without a code.

        Args:
            queries, canonical: as for ``relevancy``.

        Raises:
            InputError: as ``relevancy``.
        """
        both, count = self._checked_vectors(queries, canonical)
        out = torch.empty(len(self.levels), count, len(self), device=both.device)
        for level, atoms in enumerate(self.codebook):
            for rows, dense in self._dense_codes(level):
                cosines = cosines_from_codes(dense, atoms, both).T[None]
                out[level, :, rows] = relevancy(cosines[:, :count], cosines[:, count:])[0]
        return out

    def gaussian_features(self, level: str | int) -> Tensor:
        """The decoded codes of all Gaussians at one level: [N, D] float32, unit norm; zero without a code.

        Raises:
            InputError: there is no such level.
        """
        index = self.level_index(level)
        out = torch.empty(len(self), self.dim, device=self.codebook.device)
        for rows, dense in self._dense_codes(index):
            out[rows] = torch.nn.functional.normalize(dense @ self.codebook[index], dim=1)
        return out

    def _dense_codes(self, level: int) -> Iterator[tuple[slice, Tensor]]:
        """The codes of one level as [M, L] float32, some Gaussians at a time, with their rows."""
        for start in range(0, len(self), GAUSSIANS_AT_A_TIME):
            rows = slice(start, start + GAUSSIANS_AT_A_TIME)
            indices, weights = self.code_indices[rows, level].long(), self.code_weights[rows, level]
            dense = torch.zeros(len(indices), self.n_atoms, device=self.codebook.device)
            yield rows, dense.scatter_add_(1, indices, weights.float())

    def level_index(self, level: str | int) -> int:
        """Position of a level given by name or position."""
        if isinstance(level, int):
            if not 0 <= level < len(self.levels):
                raise InputError(f"there is no level {level}; levels: {', '.join(self.levels)}")
            return level
        if level not in self.levels:
            raise InputError(f"there is no level {level!r}; levels: {', '.join(self.levels)}")
        return self.levels.index(level)

    def view(
        self,
        encoder: Encoder | None = None,
        words: Sequence[str] | None = None,
        most: int = 1_000_000,
        remote: bool = False,
        height: int = 640,
    ) -> Viewer:
        """The field in the browser, as `scoup view` shows it; in a notebook the page itself.

        Args:
            encoder: see ``text_encoder``.
            words: what a click chooses from; by default everyday words, or the names of the table.
            most: Gaussians that the page shows at most, the most opaque and largest.
            remote: show rendered pictures only, for scenes that are too much for the browser.
            height: of the page in a notebook, in pixels.

        Returns:
            A viewer, open until its ``close`` or the end of the process; its ``address`` is that of the page.

        Raises:
            ScoupError: a package or the page is missing, or an encoder was given and cannot be opened.
            InputError: there is no geometry, or a number is out of range.
        """
        from scoup.view.viewer import open_viewer

        return open_viewer(self, encoder, words, most, remote, height)

    # ---- its file

    def save(
        self,
        path: str | Path,
        overwrite: bool = False,
        embed_geometry: bool | None = None,
        weight_bits: int = 16,
    ) -> None:
        """Write the field to one ``.scoup`` file (docs/formats.md), atomically.

        Args:
            path: the file.
            overwrite: replace what is there.
            embed_geometry: put the Gaussians into the file too. By default, only if they are in memory and the field
                names no file that holds them: such a field could not be queried after loading.
            weight_bits: 16 (float16) or 8 (255 steps of each code's largest weight).

        Raises:
            OutputExistsError: the file is there and ``overwrite`` is false.
            WriteError: the system refuses.
        """
        if embed_geometry is None:
            embed_geometry = self.geometry_path is None and self.has_geometry
        parts = FieldParts(
            self.code_indices,
            self.code_weights,
            self.codebook,
            self.info,
            self.gaussians if embed_geometry else None,
            self.geometry_path,
            self.cameras,
            self.things,
        )
        write_field(parts, Path(path), overwrite, weight_bits)
        self.path = Path(path)
        self.tables_folder = self.path.parent

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
        optional = (Gaussians, type(None))
        check_arguments("LanguageField.load", path=(path, PATH), gaussians=(gaussians, optional))
        path = Path(path)
        parts = read_field(path)
        with field_damage_named(path):
            codes = parts.code_indices, parts.code_weights, parts.codebook
            known = {"geometry_path": parts.geometry_path, "cameras": parts.cameras, "things": parts.things}
            loaded = cls(*codes, parts.info, **known)
        loaded.path, loaded.tables_folder = path, path.parent
        if gaussians is not None:
            loaded.attach(gaussians, f"{path} with the Gaussians given")
        elif parts.gaussians is not None:
            loaded.attach(parts.gaussians, f"{path}, the Gaussians embedded in it")
        return loaded

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
