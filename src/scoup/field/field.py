"""The artefact: codes over the Gaussians of one scene, with all that belongs to them. It is data, and answers nothing:
``scoup.LanguageField`` does."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import replace
from numbers import Integral
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base import InputError, WorldFrame, check_arguments, counted, invalid_contents
from scoup.field.artefact import read_field, write_field
from scoup.field.cache import Cache, state_of
from scoup.field.container import INCOMPLETE
from scoup.field.cosines import FieldCodes, PixelCosines, pixel_relevancy, relevancy
from scoup.field.field_info import FieldInfo, check_parts
from scoup.field.thing_table import NameTable, ThingTable
from scoup.io import load_gaussians
from scoup.scene import Camera, Cameras, Gaussians, chosen_rows, estimate_up, query_vectors, rows_of

Value = TypeVar("Value")
Own = TypeVar("Own", bound="Field")
Vectors: TypeAlias = "Tensor | ArrayLike"
CACHE_BYTES, BYTES_PER_CODE = 64 << 20, 16
"""A field keeps so many bytes of what its next question needs, and so many more per Gaussian and level."""


class Field:
    """Sparse codes of every Gaussian at every level, their codebook, and the geometry they belong to, as one file.

    ``load`` reads one and the steps of a build make one. Fields are not changed: methods that change something return
    another field, which shares its tensors. ``cache`` is what a field keeps between questions.

    Args:
        code_indices: [N, S, K] uint8 (uint16 beyond 256 atoms).
        code_weights: [N, S, K] float16; all zero for a Gaussian that contributes to no region.
        codebook: [S, L, D] float32.
        info: levels, model, fingerprint, provenance.
        gaussians: the geometry; None: loaded from ``geometry_path`` at first use.
        geometry_path: the file with the geometry.
        cameras: of the views it was built from.
        thing_table: instances of the scene; with None, the votes of the Gaussians answer alone.

    Raises:
        InputError: shapes, dtypes or values do not fit together.
        GeometryMismatchError: ``gaussians`` are not those the codes were made for.

    Example:
        >>> field = scoup.LanguageField.load("f.scoup")
        >>> field.render_codes("view_00.png").shape
        torch.Size([3, 30, 40, 16])
    """

    def __init__(
        self,
        code_indices: Vectors,
        code_weights: Vectors,
        codebook: Vectors,
        info: FieldInfo,
        gaussians: Gaussians | None = None,
        geometry_path: Path | None = None,
        cameras: Cameras | None = None,
        thing_table: ThingTable | None = None,
    ) -> None:
        self.code_indices, self.codebook = torch.as_tensor(code_indices), torch.as_tensor(codebook)
        self.code_weights = torch.as_tensor(code_weights).to(torch.float16)
        check_parts(self.code_indices, self.code_weights, self.codebook, info, thing_table)
        self.info, self.cameras, self.thing_table = info, cameras, thing_table
        self.geometry_path = geometry_path
        self.path: Path | None = None  # the file it was read from or last saved to
        self.cache = Cache(CACHE_BYTES + BYTES_PER_CODE * self.code_indices[..., 0].numel())
        self._gaussians: Gaussians | None = None
        if gaussians is not None:
            self.attach(gaussians)

    def __len__(self) -> int:
        return self.code_indices.shape[0]

    def __repr__(self) -> str:
        sizes = f"{self.n_atoms} atoms, {self.dim} dimensions of {self.embedding_model or 'an unnamed model'}"
        levels = ", ".join(self.levels)
        return f"{type(self).__name__}({len(self):,} Gaussians, levels {levels}, {sizes})"

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
    def world(self) -> WorldFrame:
        """Its frame in the world: length of the unit, up, place on Earth, name."""
        return self.info.world

    def up(self) -> Tensor:
        """Return the unit vector that is up, [3] float64: that of ``world``, else estimated from the cameras."""
        if self.world.up is not None:
            return torch.tensor(self.world.up, dtype=torch.float64)
        return estimate_up(self.cameras or ())

    @property
    def n_atoms(self) -> int:
        return self.codebook.shape[1]

    @property
    def dim(self) -> int:
        """D, the size of an embedding."""
        return self.codebook.shape[2]

    @property
    def codes(self) -> FieldCodes:
        """The codes and their codebook."""
        return FieldCodes(self.code_indices, self.code_weights, self.codebook)

    def level_index(self, level: str | int) -> int:
        """Return the position of a level, given by name or position."""
        if not isinstance(level, str) and level in range(len(self.levels)):
            return int(level)
        if level not in self.levels:
            named = repr(level) if isinstance(level, str) else level
            raise InputError(f"there is no level {named}; expected one of {', '.join(self.levels)}")
        return self.levels.index(level)

    def coded(self) -> Tensor:
        """Return the mask of Gaussians with a code at any level, boolean [N]."""
        return self.coded_levels().any(0)

    def coded_levels(self) -> Tensor:
        """Return the mask of Gaussians with a code at each level, boolean [S, N]; do not change it."""
        return self.kept("coded levels", self.codes.coded)

    def kept(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return a value from ``cache``; make it if it is not there, or if codes, things or geometry have changed."""
        return self.cache.value(key, make, self.parts())

    def parts(self) -> list[object]:
        """Return the dependencies of answers: tensors, and the cameras, which define up."""
        known = self._gaussians
        geometry = () if known is None else (known.means, known.scales, known.opacities)
        codes = self.code_indices, self.code_weights, self.codebook
        return [*codes, self.thing_table, self.cameras, *geometry]

    # ---- geometry and cameras

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
                raise InputError(
                    f"{self.path or 'this field'}: does not say where its Gaussians are; pass them: "
                    "LanguageField.load(path, gaussians)"
                )
            self.attach(load_gaussians(self.geometry_path), str(self.geometry_path))
        assert self._gaussians is not None
        return self._gaussians

    def attach(self, gaussians: Gaussians, source: str = "the Gaussians given", known: bool = False) -> None:
        """Use this geometry, which messages call ``source``; fingerprints of ``known`` ones are not compared.

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
        device = self.codebook.device
        moved = gaussians if gaussians.device == device else gaussians.to(device)
        self._gaussians = moved if moved.world == self.world else replace(moved, world=self.world)

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
            problem = f"there is no camera {camera}; this field has {len(self.cameras)}"
            raise InputError(problem) from None

    def project(self, camera: Camera | str | int, backend: str | None = None) -> raster.Projection:
        """Project the scene to a camera."""
        return raster.project(self.gaussians, self.camera(camera), self.raster_preset, backend)

    # ---- renders and relevancy

    def render_codes(self, camera: Camera | str | int) -> Tensor:
        """Render the coefficients of every level, [S, H, W, L] float32."""
        return raster.render_codes(self.project(camera), self.code_indices, self.code_weights, self.n_atoms)

    def render_features(self, camera: Camera | str | int, level: str | int) -> Tensor:
        """Render decoded features of one level, [H, W, D] float32, unit norm or, where nothing is rendered, zero."""
        index = self.level_index(level)
        chosen = slice(index, index + 1)
        indices, weights = self.code_indices[:, chosen], self.code_weights[:, chosen]
        return raster.render_features(self.project(camera), indices, weights, self.codebook[chosen])[0]

    def relevancy(self, camera: Camera | str | int, queries: Vectors, canonical: Vectors) -> Tensor:
        """Return the relevancy of every pixel to every query at every level (method.md, stage 3).

        Args:
            camera: of the view, or its name or position among ``cameras``. For many queries of one camera, use
                ``LanguageField.at(camera).relevancy``.
            queries: [Q, D] or [D] text embeddings; scaled to unit norm.
            canonical: [P, D] embeddings of the canonical phrases. Rows longer than 1 are scaled to unit norm; shorter
                ones stay, as the mean of everyday words does (``scoup.models.words.with_everyday``).

        Returns:
            [S, Q, H, W] float32 in 0..1; 0.5 where no code is rendered.

        Raises:
            InputError: there is no query or no phrase, or one is zero, not finite or not of the field's dimensions.
        """
        queries, canonical = self._checked_vectors(queries, canonical)
        both, codes = torch.cat([queries, canonical]), (self.code_indices, self.code_weights, self.codebook)
        cosines = raster.render_cosines(self.project(camera), *codes, both)
        return relevancy(cosines[:, : len(queries)], cosines[:, len(queries) :])

    def _checked_vectors(self, queries: Vectors, canonical: Vectors) -> tuple[Tensor, Tensor]:
        """Return queries [Q, D] and phrases [P, D] as float32 on the device of the codes."""
        try:
            queries = query_vectors(queries, self.dim)
            canonical = query_vectors(canonical, self.dim, "canonical", lengthen=False)
        except InputError as error:
            raise InputError(
                f"{error}; this field contains embeddings of {self.embedding_model or 'an unnamed model'} with "
                f"{self.dim} dimensions"
            ) from error
        return queries.to(self.codebook.device), canonical.to(self.codebook.device)

    def view_relevancy(
        self, projection: raster.Projection, cache: Cache, queries: Vectors, canonical: Vectors
    ) -> Tensor:
        """Return the relevancy of every pixel of a projection, as ``relevancy`` does; ``cache`` is of this view, and
        keeps what further queries reuse."""
        vectors = self._checked_vectors(queries, canonical)
        parts = self.parts()
        since = state_of(parts)
        maps, known = pixel_relevancy(projection, self.codes, *vectors, cache.get(PixelCosines, parts))
        cache.keep(PixelCosines, known, parts, since)
        return maps

    def gaussian_relevancy(self, queries: Vectors, canonical: Vectors) -> Tensor:
        """Return the relevancy of every Gaussian's own code, without rendering: [S, Q, N] float32; 0.5 without a code.

        Arguments and errors are those of ``relevancy``.
        """
        queries, canonical = self._checked_vectors(queries, canonical)
        norms = self.kept("inverse norms", self.codes.inverse_norms)
        key = "largest cosines", canonical.cpu().numpy().tobytes()
        return self.kept(key, lambda: self.codes.cosines(canonical, norms)).relevancy(queries)

    def gaussian_features(self, level: str | int) -> Tensor:
        """Return the decoded codes of all Gaussians at one level: [N, D] float32, unit norm; zero without a code.

        Raises:
            InputError: there is no such level.
        """
        return self.codes.features(self.level_index(level))

    # ---- fields made from it

    def to(self: Own, device: torch.device | str) -> Own:
        """Return the field with its tensors, and its geometry if loaded, on a device; itself if it is there already."""
        target, known = torch.empty(0, device=device).device, self._gaussians
        parts = [
            self.code_indices,
            self.code_weights,
            self.codebook,
            *([] if known is None else [known.means]),
        ]
        if all(tensor.device == target for tensor in parts):
            return self
        moved = self.changed(
            None if known is None else known.to(device),
            code_indices=self.code_indices.to(device),
            code_weights=self.code_weights.to(device),
            codebook=self.codebook.to(device),
            thing_table=None if self.thing_table is None else self.thing_table.to(device),
        )
        moved.path = self.path
        return moved

    def __getitem__(self: Own, chosen: Tensor | ArrayLike | slice) -> Own:
        """Return the field of some of the Gaussians, to be queried and saved as any other.

        Args:
            chosen: a boolean mask [N], indices [M] in any order, or a slice.

        Returns:
            A field with a geometry of its own, which ``save`` embeds in the file. It has no region sums: to add or
            remove views, build it again.

        Raises:
            InputError: there is no such Gaussian, or the geometry cannot be loaded.
        """
        rows = chosen_rows(chosen, len(self)).to(self.codebook.device)
        return self.moved_to(
            self.gaussians.select(chosen),
            code_indices=rows_of(self.code_indices, rows),
            code_weights=self.code_weights[rows],
            thing_table=None if self.thing_table is None else self.thing_table.rows(rows),
        )

    def with_gaussians(self: Own, gaussians: Gaussians) -> Own:
        """Return a field with these codes on other Gaussians, one for one: after a move, new colours or fading.

        Args:
            gaussians: as many as before, in the same order.

        Returns:
            A field with a geometry of its own, as ``field[mask]`` has.

        Raises:
            InputError: there are more or fewer.
        """
        if len(gaussians) != len(self):
            raise InputError(f"{len(gaussians):,} Gaussians, but the field has codes of {len(self):,}")
        return self.moved_to(gaussians)

    def with_names(self: Own, names: NameTable) -> Own:
        """Return a field whose things have more names; of texts that have some, the new ones count.

        Raises:
            InputError: the field has no things.
        """
        check_arguments("with_names", names=(names, NameTable))
        table = self.thing_table
        if table is None:
            raise InputError(
                f"{self.path or 'this field'}: contains no things to name; build it again with things"
            )
        every = names if table.names is None else table.names.joined(names)
        named = self.changed(self._gaussians, thing_table=replace(table, names=every))
        named.path = self.path
        return named

    def with_world(self: Own, world: WorldFrame) -> Own:
        """Return the field in another frame of the world; ``save`` keeps it."""
        check_arguments("with_world", world=(world, WorldFrame))
        framed = self.changed(self._gaussians, info=replace(self.info, world=world))
        framed.path = self.path
        return framed

    def moved_to(self: Own, gaussians: Gaussians, record: dict[str, Any] | None = None, **parts: Any) -> Own:
        """Return a field of other Gaussians, with other ``parts`` of its constructor; ``record`` goes into its
        provenance, by default that it was selected from this field."""
        record = {"selected_from": self.fingerprint} if record is None else record
        info = replace(
            self.info,
            fingerprint=gaussians.fingerprint(),
            n_gaussians=len(gaussians),
            provenance={**self.info.provenance, **record},
        )
        return self.changed(
            gaussians.to(self.codebook.device), **{"info": info, "geometry_path": None, **parts}
        )

    def changed(self: Own, known: Gaussians | None, **parts: Any) -> Own:
        """Return a field of this type with other ``parts`` of its constructor, on Gaussians known to be its own."""
        made = type(self)(**{**self._arguments(), **parts})
        if known is not None:
            made.attach(known, known=True)
        return made._like(self)

    def _like(self: Own, other: Field) -> Own:
        """Return this field, which shares what another has opened."""
        return self

    def _arguments(self) -> dict[str, Any]:
        """Return the arguments of its constructor, but for the geometry."""
        names = "code_indices", "code_weights", "codebook", "info", "geometry_path", "cameras", "thing_table"
        return {name: getattr(self, name) for name in names}

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
        write_field(self, Path(path), overwrite, embed_geometry, weight_bits)
        self.path = Path(path)

    @classmethod
    def load(cls: type[Own], path: str | Path, gaussians: Gaussians | None = None) -> Own:
        """Read a ``.scoup`` file; ``LanguageField.load`` documents it."""
        return cls._loaded(path, gaussians)

    @classmethod
    def _loaded(cls: type[Own], path: str | Path, gaussians: Gaussians | None, **options: Any) -> Own:
        """Return ``load`` with further arguments of the constructor."""
        optional = (Gaussians, type(None))
        check_arguments("LanguageField.load", path=(path, Path), gaussians=(gaussians, optional))
        path = Path(path)
        arguments, embedded = read_field(path)
        with invalid_contents(path, *INCOMPLETE):
            loaded = cls(**arguments, **options)
        loaded.path = path
        if gaussians is not None:
            loaded.attach(gaussians, f"{path} with the Gaussians given")
        elif embedded is not None:
            loaded.attach(embedded, known=True)  # the file is checked: their fingerprint, too
        return loaded


class GeometryMismatchError(InputError):
    """A language field was given Gaussians other than those it was built on."""
