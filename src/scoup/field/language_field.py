"""The artefact: a language field over the Gaussians of one scene. Its questions are answered by room ``query``."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias, TypeVar, overload

import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base.arguments import PATH, check_arguments
from scoup.base.errors import InputError
from scoup.field import renders
from scoup.field.artefact import FieldParts, read_field, write_field
from scoup.field.cache import Cache
from scoup.field.container import field_damage_named
from scoup.field.derived import field_on, moved_field
from scoup.field.relevancy import FieldCodes, GaussianCosines
from scoup.field.renders import Vectors
from scoup.field.sources import camera_of, check_geometry, named_encoder, named_geometry
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import rows_of
from scoup.scene.field_info import FieldInfo, check_parts
from scoup.scene.gaussians import Gaussians, chosen_rows
from scoup.scene.things import ThingTable

if TYPE_CHECKING:
    from scoup.models.concepts import ConceptModel
    from scoup.models.text import TextEncoder
    from scoup.query.answer import Answer
    from scoup.query.catalog import Catalog
    from scoup.query.expression import Expression
    from scoup.query.field_view import FieldView
    from scoup.query.frame import Frame
    from scoup.query.labels import GaussianLabels
    from scoup.query.place import Place
    from scoup.query.question import Question, Several
    from scoup.query.select import Reshaping
    from scoup.query.things import Thing
    from scoup.view.viewer import Viewer

Encoder: TypeAlias = "TextEncoder | Mapping[str, Tensor | ArrayLike] | str | Path"
"""What turns texts into vectors: an encoder, a dict of name -> vector, a word table's file, or a model id."""
Value = TypeVar("Value")
Asked = TypeVar("Asked", bound="str | Several | Expression")
CACHE_BYTES, BYTES_PER_CODE = 64 << 20, 16
"""A field keeps so many bytes of what its next question needs, and so many more per Gaussian and level."""


class LanguageField:
    """Sparse codes of every Gaussian at every level, their codebook, and the geometry they belong to, as one file.

    ``load`` reads one and ``scoup.build`` makes one. ``cache`` is what it keeps between questions.

    Methods that ask take a text, or what ``question`` made of texts, and raise the errors of ``question``. One text
    gives one result, a list of texts or vectors a list.

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
        >>> field.answer("kettle").level in field.levels
        True
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
        self._encoder: TextEncoder | None = None
        self.encoder_name = ""  # the argument that opened it; empty for a dict or an encoder
        if gaussians is not None:
            self.attach(gaussians)

    def __len__(self) -> int:
        return self.code_indices.shape[0]

    def __repr__(self) -> str:
        sizes = f"{self.n_atoms} atoms, {self.dim} dimensions of {self.embedding_model or 'an unnamed model'}"
        return f"LanguageField({len(self):,} Gaussians, levels {', '.join(self.levels)}, {sizes})"

    def _repr_html_(self) -> str:
        from scoup.query.drawing import field_card

        return field_card(self)

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
        """Return which Gaussians have a code at any level, boolean [N]."""
        return (self.code_weights > 0).flatten(1).any(1)

    def coded_levels(self) -> Tensor:
        """Return which Gaussians have a code at each level, boolean [S, N]; do not change it."""
        return self.kept("coded levels", self.codes.coded)

    def kept(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """Return a value from ``cache``; make it if it is not there, or if codes, things or geometry have changed."""
        return self.cache.value(key, make, self.parts())

    def parts(self) -> list[object]:
        """Return what answers depend on: tensors, and the cameras, which say where up is."""
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
            gaussians = named_geometry(self.geometry_path, str(self.path or "this field"))
            self.attach(gaussians.to(self.codebook.device), str(self.geometry_path))
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
        check_geometry(gaussians, self.info, source, known)
        self._gaussians = gaussians

    def camera(self, camera: Camera | str | int) -> Camera:
        """Return a camera by its name (with or without extension) or position among ``cameras``; or itself.

        Raises:
            UnknownNameError: there is no camera of that name.
            InputError: there are no cameras, or fewer.
        """
        check_arguments("LanguageField.camera", camera=(camera, (Camera, str, Integral)))
        return camera if isinstance(camera, Camera) else camera_of(self.cameras, camera)

    def project(self, camera: Camera | str | int, backend: str | None = None) -> raster.Projection:
        """Project the scene to a camera."""
        return raster.project(self.gaussians, self.camera(camera), self.raster_preset, backend)

    # ---- renders and relevancy

    def render_codes(self, camera: Camera | str | int) -> Tensor:
        """Render the coefficients of every level, [S, H, W, L] float32."""
        return renders.render_codes(self.project(camera), self.codes)

    def render_features(self, camera: Camera | str | int, level: str | int) -> Tensor:
        """Render decoded features of one level, [H, W, D] float32, unit norm or, where nothing is rendered, zero."""
        index = self.level_index(level)
        return renders.render_features(self.project(camera), self.codes, index)

    def relevancy(self, camera: Camera | str | int, queries: Vectors, canonical: Vectors) -> Tensor:
        """Return the relevancy of every pixel to every query at every level (method.md, stage 3).

        Args:
            camera: of the view, or its name or position among ``cameras``. For many queries of one camera, use
                ``at(camera).relevancy``.
            queries: [Q, D] or [D] text embeddings; scaled to unit norm.
            canonical: [P, D] embeddings of the canonical phrases. Rows longer than 1 are scaled to unit norm; shorter
                ones stay, as the mean of everyday words does (``scoup.models.words.with_everyday``).

        Returns:
            [S, Q, H, W] float32 in 0..1; 0.5 where no code is rendered.

        Raises:
            InputError: there is no query or no phrase, or one is zero, not finite or not of the field's dimensions.
        """
        vectors = renders.checked_vectors(self.codes, self.embedding_model, queries, canonical)
        return renders.fresh_relevancy(self.project(camera), self.codes, *vectors)

    def gaussian_relevancy(self, queries: Vectors, canonical: Vectors) -> Tensor:
        """Return the relevancy of every Gaussian's own code, without rendering: [S, Q, N] float32; 0.5 without a code.

        Arguments and errors are those of ``relevancy``.
        """
        queries, canonical = renders.checked_vectors(self.codes, self.embedding_model, queries, canonical)
        norms = self.kept("inverse norms", self.codes.inverse_norms)
        key = "largest cosines", canonical.cpu().numpy().tobytes()
        return self.kept(key, lambda: GaussianCosines.of(self.codes, norms, canonical)).relevancy(queries)

    def gaussian_features(self, level: str | int) -> Tensor:
        """Return the decoded codes of all Gaussians at one level: [N, D] float32, unit norm; zero without a code.

        Raises:
            InputError: there is no such level.
        """
        return renders.gaussian_features(self.codes, self.level_index(level))

    # ---- questions

    @property
    def encoder_source(self) -> str:
        """The word table or model that encodes texts.

        Raises:
            InputError: the field names none.
            MissingFileError: the table is missing.
        """
        return named_encoder(self.info, str(self.path or "this field"))

    def text_encoder(self, encoder: Encoder | None = None) -> TextEncoder:
        """Return the encoder of this field's texts; opened at its first use and kept.

        Args:
            encoder: used from now on; None for the last one, at first the table or model that the field names.

        Raises:
            InputError: the field names none.
            MissingFileError, FileFormatError, ScoupError: it cannot be opened (``TextEncoder.open``).
        """
        from scoup.models.text import TextEncoder

        kinds = (TextEncoder, Mapping, str, Path, type(None))
        check_arguments("text_encoder", encoder=(encoder, kinds))
        if encoder is None:
            if self._encoder is not None:
                return self._encoder
            encoder = self.encoder_source
        name = str(encoder) if isinstance(encoder, (str, Path)) else ""
        if isinstance(encoder, TextEncoder):
            found = encoder
        elif self._encoder is not None and name and name == self.encoder_name:
            found = self._encoder
        else:
            found = TextEncoder.open(encoder, device=self.codebook.device)
        if found is not self._encoder:
            self.cache.clear()
        self._encoder = found
        self.encoder_name = name
        return self._encoder

    def keep_encoder_of(self, other: LanguageField) -> None:
        """Use the encoder that another field has open, or would open."""
        self._encoder, self.encoder_name = other._encoder, other.encoder_name

    def question(
        self,
        texts: Asked,
        *,
        encoder: Encoder | None = None,
        always: bool = False,
        present_from: float | None = None,
        threshold: float | None = None,
        level: str | int | None = None,
        frame: Frame | None = None,
        refine: ConceptModel | str | None = None,
    ) -> Question[Asked]:
        """Make a question, which every method of a field takes; texts alone are a question without options.

        Args:
            texts: one, or a list. Each may be a phrase ("mug left of the laptop", "largest box", "how many cups",
                "what is on the table") or an expression ("mug and not handle"); double quotes take a text as it is
                (``scoup.parse_expression``). Or vectors [Q, D] of the field's embedding model, of any norm but zero.
            encoder: see ``text_encoder``. For vectors, a dict of the canonical phrases ("object", "things", "stuff",
                "texture") is enough.
            always: find something for any text; presence is not judged.
            present_from: by default 0.37, where there are enough everyday words; see ``Question``.
            threshold, level: see ``Question``.
            frame: what left, front and up mean in phrases; by default ``field.frame()``.
            refine: a model with words, or its name, that first looks for the texts in photographs
                (``scoup.query.refine``).

        Raises:
            InputError, UnknownNameError: texts or options do not fit the field, a number is out of range, or the field
                names no encoder.
            MissingFileError, FileFormatError, ScoupError: the encoder cannot be opened (``TextEncoder.open``).

        Example:
            >>> field.question("kettle", level="m", always=True).level
            1
        """
        from scoup.query.question import make_question

        if refine is not None:
            from scoup.query.refine import refine_texts

            self.text_encoder(encoder)
            refine_texts(self, texts, refine)
        return make_question(self, texts, encoder, always, present_from, threshold, level, frame)

    @overload
    def answer(self, question: str | Question[str]) -> Answer: ...
    @overload
    def answer(self, question: Several | Question[Several]) -> list[Answer]: ...
    def answer(self, question: str | Several | Question[str] | Question[Several]) -> Answer | list[Answer]:
        """Return what answers a text, decided once in the scene. ``at(camera).answer`` shows it in a view.

        Example:
            >>> field.answer(field.question("kettle", always=True)).presence
            True
            >>> ", ".join(answer.text for answer in field.answer(["kettle", "wooden table"]))
            'kettle, wooden table'
        """
        from scoup.query.ask import answer

        return answer(self, question)

    def at(self, camera: Camera | str | int, scale: float = 1.0, backend: str | None = None) -> FieldView:
        """Return the field as a camera sees it, for several questions: they reuse its projection.

        Args:
            camera: of the view, or its name or position among ``cameras``.
            scale: of the picture, for a quicker look: with 0.25 all is in pixels of a view of a quarter of the width.
            backend: of the rasteriser; by default the best one.

        Raises:
            InputError, UnknownNameError: there is no such camera, or the scale is not above 0.

        Example:
            >>> view = field.at("view_00.png")
            >>> view.answer("kettle").mask.shape, view.relevancy(torch.ones(1, 16), torch.ones(1, 16)).shape
            (torch.Size([30, 40]), torch.Size([3, 1, 30, 40]))
        """
        from scoup.query.field_view import FieldView

        return FieldView(self, camera, scale, backend)

    @overload
    def location(self, question: str | Question[str] | Answer) -> Place: ...
    @overload
    def location(self, question: Several | Question[Several]) -> list[Place]: ...
    def location(
        self, question: str | Several | Question[str] | Question[Several] | Answer
    ) -> Place | list[Place]:
        """Return where something is in the world: the position, oriented box and Gaussians of the best thing.

        It also takes an answer of ``answer``. Its ``position`` is None for what is not there.

        Example:
            >>> field.location(field.question("kettle", always=True)).position.shape
            torch.Size([3])
        """
        from scoup.query.place import location

        return location(self, question)

    def things(self, question: Question | str | Several | None = None) -> list[Thing]:
        """Return the things of the scene, or every one that answers a text or phrase, best first.

        Args:
            question: a text, phrase or expression, or several of which any may answer; None: every thing, finer levels
                first.

        Returns:
            Things of the field's table; without one, and with a threshold, the connected parts of the selection.

        Example:
            >>> field.things(field.question("kettle", always=True))[0].text
            'kettle'
        """
        from scoup.query.ask import things

        return things(self, question)

    def relations(self, frame: Frame | None = None) -> list[tuple[int, str, int]]:
        """Return which things are on or inside others of their level: (number, "on" or "inside", number of the other).

        ``frame`` says what up means; by default ``field.frame()``.

        Example:
            >>> {what for _, what, _ in field.relations()} <= {"on", "inside"}
            True
        """
        from scoup.query.relations import relations

        return relations(self, frame)

    def catalog(self, question: Question | str | Several, frame: Frame | None = None) -> Catalog:
        """Name the things of the scene with several words: an object map, or scene graph. Some have no name.

        ``frame`` says what up means. A field without things raises InputError.

        Example:
            >>> catalog = field.catalog(["kettle", "wooden table"])
            >>> catalog.to_dict()["format"], len(catalog.things) == len(catalog.names)
            ('scoup scene graph', True)
        """
        from scoup.query.catalog import make_catalog

        return make_catalog(self, question, frame)

    def frame(self, camera: Camera | str | int | None = None, up: Sequence[float] | None = None) -> Frame:
        """Return what left, front and up mean in phrases such as "mug left of the laptop".

        Args:
            camera: from which left, right, front and back are meant, or its name or position among ``cameras``; by
                default the camera that sees the most Gaussians.
            up: world direction; by default estimated from the cameras, which people hold level.

        Example:
            >>> field.frame("view_00.png").seen_from
            'view_00.png'
        """
        from scoup.query.frame import Frame, scene_frame

        if camera is None and up is None:
            return self.kept((Frame, self.cameras), lambda: scene_frame(self))
        return scene_frame(self, camera, up)

    def select(self, question: Question | str | Several, reshaping: Reshaping | None = None) -> Answer:
        """Return one answer to an expression, such as "mug and not handle"; several are combined with `or`.

        The ``parts`` of the answer are the answers to its texts.

        Args:
            question: an expression (``scoup.parse_expression``).
            reshaping: changes the selection afterwards.

        Example:
            >>> found = field.select("kettle and not wooden table")
            >>> found.mask.shape, [part.text for part in found.parts]
            (torch.Size([150]), ['kettle', 'wooden table'])
        """
        from scoup.query.select import select

        return select(self, question, reshaping)

    def label(self, question: Question | str | Several) -> GaussianLabels:
        """Return the word that fits each Gaussian best, or "none", which cannot be a word itself. Repeated words
        count once.

        Example:
            >>> sorted(field.label(["kettle", "wooden table"]).counts())
            ['kettle', 'none', 'wooden table']
        """
        from scoup.query.labels import label

        return label(self, question)

    def view(
        self,
        encoder: Encoder | None = None,
        words: Sequence[str] | None = None,
        most: int = 1_000_000,
        remote: bool = False,
        height: int = 640,
    ) -> Viewer:
        """Show the field in the browser, as `scoup view` does; in a notebook return the page itself.

        Args:
            encoder: see ``text_encoder``.
            words: what a click chooses from; by default everyday words, or the names of the table.
            most: Gaussians that the page shows at most; neighbours are merged until no more are left.
            remote: show rendered pictures only, for scenes that are too much for the browser.
            height: of the page in a notebook, in pixels.

        Returns:
            A viewer, open until its ``close`` or the end of the process; its ``address`` is that of the page.
        """
        from scoup.view.viewer import open_viewer

        return open_viewer(self, encoder, words, most, remote, height)

    # ---- fields made from it

    def to(self, device: torch.device | str) -> LanguageField:
        """Return the field with its tensors, and its geometry if loaded, on a device; itself if it is there already."""
        return moved_field(self, device)

    def __getitem__(self, chosen: Tensor | ArrayLike | slice) -> LanguageField:
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
        thing_table = None if self.thing_table is None else self.thing_table.rows(rows)
        gaussians = self.gaussians.select(chosen)
        return field_on(
            self, gaussians, rows_of(self.code_indices, rows), self.code_weights[rows], thing_table
        )

    def with_gaussians(self, gaussians: Gaussians) -> LanguageField:
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
        gaussians = gaussians.to(self.codebook.device)
        return field_on(self, gaussians, self.code_indices, self.code_weights, self.thing_table)

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
            self.thing_table,
        )
        write_field(parts, Path(path), overwrite, weight_bits)
        self.path = Path(path)

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
            known = {
                "geometry_path": parts.geometry_path,
                "cameras": parts.cameras,
                "thing_table": parts.things,
            }
            loaded = cls(*codes, parts.info, **known)
        loaded.path = path
        if gaussians is not None:
            loaded.attach(gaussians, f"{path} with the Gaussians given")
        elif parts.gaussians is not None:
            loaded.attach(parts.gaussians, known=True)  # the file is checked: their fingerprint, too
        return loaded
