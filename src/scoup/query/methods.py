"""The queries of a language field as its methods, each in one call."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, overload

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor

from scoup import raster
from scoup.base.arguments import check_arguments
from scoup.base.errors import InputError, MissingFileError
from scoup.query.answer import Answer, SceneAnswer
from scoup.query.answering import answer_scene, answer_view
from scoup.query.edits import combined_answer
from scoup.query.expression import parse_expression
from scoup.query.finding import Finding
from scoup.query.label import GaussianLabels, label
from scoup.query.locate import Location, location
from scoup.query.presence import compared, presence_threshold
from scoup.query.presets import QueryPreset, query_preset
from scoup.query.queried_field import QueriedField
from scoup.query.reshape import UNCHANGED, Reshaping
from scoup.query.text_vectors import TextVectors, encode_texts
from scoup.scene.cameras import Camera
from scoup.scene.directions import query_vectors

if TYPE_CHECKING:
    from scoup.models.text import TextEncoder

Texts: TypeAlias = "str | Sequence[str] | Tensor | np.ndarray"
"""One text or several, or vectors [D] or [Q, D] in their place."""
Encoder: TypeAlias = "TextEncoder | Mapping[str, Tensor | ArrayLike] | str | Path"
"""What turns texts into vectors: an encoder, a dict of name -> vector, a word table's file, or a model by its id."""


class FieldQueries(QueriedField):
    """Methods of a field that answer texts, by the rules of `scoup query` and `scoup select`.

    Attributes:
        tables_folder: where a word table that the field names is sought; that of the field's file.

    All of them compare as `scoup query` does: with the canonical phrases and, by default, with everyday words, which
    also judge whether the thing is there at all.
    """

    tables_folder: Path | None = None
    _encoder: TextEncoder | None = None
    _encoder_name: str = ""  # as it was opened; empty for a dict or an encoder

    @property
    def encoder_source(self) -> str:
        """The model or table to open for texts: a table is sought beside the field's file, as its geometry is.

        Raises:
            InputError: the field names none.
            MissingFileError: the table is not there.
        """
        from scoup.models.word_table import is_table

        name = self.embedding_model
        if not name:
            raise InputError(
                f"{self.path or 'this field'}: names no embedding model; pass encoder=..., a word table, a model id, "
                "or a dict of name -> vector"
            )
        if not is_table(name):
            return name
        beside = Path(name) if self.tables_folder is None else self.tables_folder / name
        found = next((place for place in (beside, Path(name)) if place.is_file()), None)
        if found is None:
            problem = "is not there, and the field names it as its word table"
            raise MissingFileError(beside, problem, "say where it is now (--text, or encoder=... in Python)")
        return str(found)

    def text_encoder(self, encoder: Encoder | None = None) -> TextEncoder:
        """The encoder of this field's texts; opened at its first use and kept.

        Args:
            encoder: to be used from now on; None for the last one, at first the model or table that the field names.

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
            self._encoder = encoder
        elif self._encoder is None or not name or name != self._encoder_name:
            self._encoder = TextEncoder.open(encoder, device=self.codebook.device)
        self._encoder_name = name
        return self._encoder

    def keep_encoder_of(self, other: FieldQueries) -> None:
        """Use the encoder that another field has open, or would open."""
        self._encoder, self._encoder_name = other._encoder, other._encoder_name
        self.tables_folder = other.tables_folder

    def text_vectors(self, texts: Texts, encoder: Encoder | None = None) -> TextVectors:
        """The vectors of texts, or vectors as they are, with what they are compared with.

        Args:
            texts: one or several; vectors must come from the field's embedding model and are scaled to unit norm.
            encoder: see ``text_encoder``. For vectors, a dict of the canonical phrases ("object", "things", "stuff",
                "texture") will do.

        Raises:
            InputError, UnknownNameError: as ``text_encoder`` and ``scoup.encode_texts``.
        """
        words = [texts] if isinstance(texts, str) else texts
        if isinstance(words, (list, tuple)) and all(isinstance(word, str) for word in words):
            if not words:
                raise InputError('give at least one text to look for, for example "kettle"')
            return encode_texts(self.text_encoder(encoder), self, words)
        queries = query_vectors(_vectors(texts), self.dim)
        names = tuple(f"query {number}" for number in range(1, len(queries) + 1))
        return replace(encode_texts(self.text_encoder(encoder), self, []), texts=names, queries=queries)

    @overload
    def query(self, texts: str, *arguments: Any, **options: Any) -> Answer: ...
    @overload
    def query(self, texts: list[str] | tuple[str, ...], *arguments: Any, **options: Any) -> list[Answer]: ...
    @overload
    def query(self, texts: Texts, *arguments: Any, **options: Any) -> Answer | list[Answer]: ...
    def query(
        self,
        texts: Texts,
        camera: Camera | str | int = 0,
        *,
        encoder: Encoder | None = None,
        preset: str | QueryPreset = "default",
        present_from: float | None = None,
        always: bool = False,
        projection: raster.Projection | None = None,
        level: str | int | None = None,
    ) -> Answer | list[Answer]:
        """Where something is in one view.

        Args:
            texts: what to look for.
            camera: of the view, or its name or position among ``cameras``.
            encoder: see ``text_encoder``.
            preset: how relevancy becomes masks and points (``scoup.query.presets.QUERY_PRESETS``); those other than
                "default" follow the papers' systems, find something always and do without everyday words.
            present_from: a text is in the view if its z-score is at least this; by default 1.4, where there are enough
                everyday words.
            always: find something for any text.
            projection: what ``field.project(camera)`` gave, if it is known: further queries with it take less time.
            level: the one that answers, its name or position; None: the preset chooses.

        Returns:
            An answer, or one for each of several texts or vectors.

        Raises:
            InputError, UnknownNameError: texts, camera or preset do not fit the field, or a number is out of range.
        """
        check_arguments("query", preset=(preset, (str, QueryPreset)))
        preset = query_preset(preset) if isinstance(preset, str) else preset
        vectors, present_from = compared(self.text_vectors(texts, encoder), preset, present_from, always)
        answers = answer_view(self, camera, vectors, preset, present_from, projection, level)
        return answers[0] if _is_single(texts) else answers

    @overload
    def ask(self, texts: str, *arguments: Any, **options: Any) -> Finding: ...
    @overload
    def ask(self, texts: list[str] | tuple[str, ...], *arguments: Any, **options: Any) -> list[Finding]: ...
    @overload
    def ask(self, texts: Texts, *arguments: Any, **options: Any) -> Finding | list[Finding]: ...
    def ask(
        self,
        texts: Texts,
        cameras: Iterable[Camera | str | int] | None = None,
        *,
        encoder: Encoder | None = None,
        preset: str | QueryPreset = "default",
        present_from: float | None = None,
        always: bool = False,
        level: str | int | None = None,
    ) -> Finding | list[Finding]:
        """Where something is in the views of several cameras and in the world: all that `scoup query` says of it.

        Args:
            texts: what to look for.
            cameras: of the views, or their names or positions among ``cameras``; by default all of those.
            encoder, preset, present_from, always, level: as for ``query``.

        Returns:
            A finding, or one for each of several texts or vectors.

        Raises:
            InputError, UnknownNameError: as ``query``.
        """
        check_arguments("ask", preset=(preset, (str, QueryPreset)))
        preset = query_preset(preset) if isinstance(preset, str) else preset
        vectors, present_from = compared(self.text_vectors(texts, encoder), preset, present_from, always)
        views = self.cameras or () if cameras is None else cameras
        answers = [answer_view(self, camera, vectors, preset, present_from, level=level) for camera in views]
        scene = answer_scene(self, vectors, present_from=present_from, level=level)
        found = [
            Finding(answer.text, tuple(of_view[number] for of_view in answers), location(self, answer))
            for number, answer in enumerate(scene)
        ]
        return found[0] if _is_single(texts) else found

    @overload
    def locate(self, texts: str, *arguments: Any, **options: Any) -> Location: ...
    @overload
    def locate(
        self, texts: list[str] | tuple[str, ...], *arguments: Any, **options: Any
    ) -> list[Location]: ...
    @overload
    def locate(self, texts: Texts, *arguments: Any, **options: Any) -> Location | list[Location]: ...
    def locate(
        self,
        texts: Texts,
        *,
        encoder: Encoder | None = None,
        threshold: float | None = None,
        neighbours: int = 0,
        present_from: float | None = None,
        always: bool = False,
        level: str | int | None = None,
    ) -> Location | list[Location]:
        """Where something is in the world: position, oriented box, confidence, and the Gaussians.

        Args:
            texts, encoder, present_from, always: as for ``query``.
            threshold: a Gaussian answers above this, 0 to 1, once relevancy is rescaled over the scene; by default the
                threshold at which the answer changes least (``scoup.query.stable_threshold``).
            neighbours: blend each Gaussian's relevancy with the mean of so many nearest neighbours; 0 is off.
            level: the one that answers, its name or position; by default the one that fits best.

        Returns:
            A location, or one for each of several texts or vectors. One whose ``position`` is None is not there.

        Raises:
            InputError, UnknownNameError: the texts do not fit the field, or a number is out of range.
        """
        vectors = self.text_vectors(texts, encoder)
        present_from = None if always else presence_threshold(vectors, present_from)
        answers = answer_scene(
            self,
            vectors.with_everyday(),
            threshold,
            neighbours or None,
            present_from=present_from,
            level=level,
        )
        found = [location(self, answer) for answer in answers]
        return found[0] if _is_single(texts) else found

    def find(
        self,
        expression: str | Sequence[str],
        *,
        encoder: Encoder | None = None,
        threshold: float | None = None,
        neighbours: int = 0,
        present_from: float | None = None,
        always: bool = False,
        level: str | int | None = None,
        reshaping: Reshaping = UNCHANGED,
    ) -> SceneAnswer:
        """The Gaussians that answer an expression over texts, such as "mug and not handle", as `scoup select` finds
        them.

        Args:
            expression: see ``scoup.query.expression.parse_expression``; of several texts any may answer.
            reshaping: what is done to the selection afterwards.
            encoder, threshold, neighbours, present_from, always, level: as for ``locate``.

        Raises:
            InputError, UnknownNameError: it is no expression, its texts do not fit the field, or a number is out of
                range.
        """
        parsed = parse_expression([expression] if isinstance(expression, str) else expression)
        vectors = self.text_vectors(list(parsed.texts), encoder)
        present_from = None if always else presence_threshold(vectors, present_from)
        answers = answer_scene(
            self,
            vectors.with_everyday(),
            threshold,
            neighbours or None,
            present_from=present_from,
            level=level,
        )
        return combined_answer(self, parsed, answers, reshaping)

    def label(
        self,
        words: Texts,
        *,
        encoder: Encoder | None = None,
        threshold: float | None = None,
        present_from: float | None = None,
        always: bool = False,
    ) -> GaussianLabels:
        """The word that fits each Gaussian best, of several, or none of them.

        Args:
            words: names of things.
            threshold: as for ``locate``.
            encoder, present_from, always: as for ``query``.

        Raises:
            InputError, UnknownNameError: the words do not fit the field, or a number is out of range.
        """
        vectors = self.text_vectors(words, encoder)
        present_from = None if always else presence_threshold(vectors, present_from)
        return label(self, vectors.with_everyday(), threshold, present_from)


def _is_single(texts: Texts) -> bool:
    """Whether they are one text, or one vector."""
    if isinstance(texts, (list, tuple)) and any(isinstance(text, str) for text in texts):
        return False
    return isinstance(texts, str) or _vectors(texts).dim() == 1


def _vectors(texts: Texts) -> Tensor:
    """Vectors in the place of texts."""
    try:
        return torch.as_tensor(texts)
    except (TypeError, ValueError, RuntimeError):
        raise InputError(
            f"give a text, a list of texts, or vectors [D] or [Q, D], not {type(texts).__name__} {str(texts)[:60]}"
        ) from None
