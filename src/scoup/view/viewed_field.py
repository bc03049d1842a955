"""A field being viewed: the data that its page asks for, and caches between questions."""

from __future__ import annotations

import hashlib
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import torch

from scoup.base import InputError, ScoupError
from scoup.io import PlyTable
from scoup.models import WordTable
from scoup.pictures import Picture, as_picture
from scoup.query import Answer, FieldView, LanguageField, Question, SplatTable, named_things
from scoup.scene import Camera
from scoup.view import parts
from scoup.view.decimation import MOST_GAUSSIANS, decimate
from scoup.view.exact import Colors, PictureMode, draw_picture, what_is_at
from scoup.view.parts import Parts
from scoup.view.scene_answers import PageAnswer, scene_answers
from scoup.view.scene_data import UnitCodes, atom_scores, part_data, scene_data, scene_metadata

THUMBNAIL_WIDTH = 160
NO_WORDS = "this page was exported without words"


class ViewedField:
    """A field with what its page needs. Not for several threads at once.

    Attributes:
        name: of the field, its title.
        words_problem: why no text can be asked; None if texts can.
        table: the table or model that was given for texts, as commands name it; None if none was.

    Args:
        field: to be shown; its geometry must be at hand. If the encoder that it names cannot be opened, it is shown
            without, and ``words_problem`` says why no text can be asked.
        words: the vocabulary that a click chooses from; by default everyday words, or the names of the table.
        most: Gaussians that the page shows at most (``decimate``), and as many again of parts that are near.
    """

    def __init__(
        self, field: LanguageField, words: Sequence[str] | None = None, most: int = MOST_GAUSSIANS
    ) -> None:
        if most < 1:
            raise InputError(f"a page shows at least 1 Gaussian, got {most}")
        self.field = field
        self.gaussians = field.gaussians  # fails at once if it is missing
        self.most = most
        self.name = "field" if field.path is None else field.path.name
        self.table = str(field.words) if isinstance(field.words, (str, Path)) else None
        self.words_problem: str | None = None
        self._vocabulary: Question | None = None
        self._wanted_words = words
        try:
            self.question(self._probe)
        except ScoupError as error:
            if field.words is not None:
                raise
            self.words_problem = str(error)
        self._view: FieldView | None = None

    @cached_property
    def codes(self) -> UnitCodes:
        """The field's codes with decoded norm 1."""
        return UnitCodes.of(self.field)

    @property
    def path(self) -> str:
        """The field's file as the command line names it; a name in its place if it has none."""
        return "field.scoup" if self.field.path is None else str(self.field.path)

    def settings(self, mode: str) -> dict[str, Any]:
        """Return the settings of a page: "live", "remote" or "exported"."""
        from scoup.base import VERSION

        # The folders of this machine mean nothing elsewhere.
        path, table = (
            name if mode != "exported" or name is None or not _is_file(name) else Path(name).name
            for name in (self.path, self.table)
        )
        command = f"scoup view {shlex.quote(str(path))}"
        if table is not None:
            command += f" --text {shlex.quote(table)}"
        facts = {"mode": mode, "name": self.name, "version": VERSION, "identity": self.identity}
        return {**facts, "open": command, "field": path, "text": table}

    def vocabulary(self) -> Question | None:
        """Return the words that a click chooses from; None if the field has no text encoder."""
        if self._vocabulary is None and self.words_problem is None:
            self._vocabulary = self.field.naming_question(self._wanted_words or ())
        return self._vocabulary

    def is_closed(self) -> bool:
        """Return whether only the names of a table can be asked."""
        return self.words_problem is None and self.field.encoder.names is not None

    def question(self, texts: Sequence[str], always: bool = False, **options: Any) -> Question[list[str]]:
        """Return ``field.question`` of texts and options."""
        if self.words_problem is not None:
            raise InputError(self.words_problem)
        return self.field.question(list(texts), always=always, **options)

    @cached_property
    def identity(self) -> str:
        """A digest of geometry, codebook and things: an open page continues only with a server of the same field."""
        digest = hashlib.sha256(self.field.fingerprint.encode())
        digest.update(self.field.codebook.float().cpu().contiguous().numpy().tobytes())
        if self.field.thing_table is not None:  # answers name them by their numbers
            digest.update(self.field.thing_table.owners.cpu().contiguous().numpy().tobytes())
        return digest.hexdigest()[:16]

    def metadata(self, exported: bool = False) -> dict[str, Any]:
        """Return the metadata of the field for a page (``scene_metadata``); an exported page names no missing file, and
        has the things there, too."""
        if not exported:
            return dict(self._metadata)
        problem = {} if self.words_problem is None else {"words_problem": NO_WORDS}
        return {**self._metadata, **problem, "things": self.things()}

    @cached_property
    def _metadata(self) -> dict[str, Any]:
        present_from = None if self.words_problem is not None else self.question(self._probe).present_from
        return scene_metadata(self.field, self.name, self.words_problem, present_from)

    def scene(self, effort: int = 1, exported: bool = False) -> bytes:
        """Return the file that the page loads first (``scene_data``).

        Of a large scene it has few Gaussians, to be seen until the parts are there. Its ``parts`` say how many of them
        stand for each part, its ``most`` how many Gaussians whole parts may have together if parts are merged.
        """
        canonical, metadata = None, self.metadata(exported)
        if self.words_problem is None:
            canonical = atom_scores(self.field, self.question(self._probe).canonical)
        if self._parts is None:
            gaussians = decimate(self.gaussians.to("cpu"), self.most, self._owners)
        else:
            gaussians, counts = self._parts.coarse()
            metadata = {**metadata, "parts": counts}
            if self._parts.merges and not exported:
                metadata["most"] = self.most
        return scene_data(self.field, gaussians, canonical, metadata, effort)

    @property
    def n_parts(self) -> int:
        """Number of parts that the page loads after its first file; 0 of a small scene."""
        return 0 if self._parts is None else len(self._parts)

    def part(self, number: int, effort: int = 1, whole: bool = False) -> bytes:
        """Return the file of a part of a large scene, counted from 0 (``part_data``); ``whole`` without merging."""
        if self._parts is None or not 0 <= number < len(self._parts):
            raise InputError(f"there is no part {number}; this scene has {self.n_parts:,} parts")
        return part_data(self.field, self._parts.part(number, whole), effort)

    @cached_property
    def _parts(self) -> Parts | None:
        if min(self.most, len(self.field)) <= 2 * parts.COARSE_GAUSSIANS:
            return None
        return Parts(self.gaussians.to("cpu"), self.most, self._owners)

    @property
    def _owners(self) -> torch.Tensor | None:
        """[N] things that a click selects."""
        table = self.field.thing_table
        return None if table is None else table.owners[:, len(self.field.levels) // 2].cpu()

    def answers(self, texts: Sequence[str], always: bool = False) -> list[PageAnswer]:
        """Return the answers of the scene to texts."""
        answers = scene_answers(self.field, self.question(texts, always))
        return [replace(answer, text=text) for text, answer in zip(texts, answers, strict=True)]

    def picture(
        self,
        camera: Camera,
        mode: PictureMode = "color",
        texts: Sequence[str] = (),
        colors: Colors = (),
        opacity: float = 1.0,
        level: int | None = None,
        threshold: float | None = None,
        always: bool = False,
    ) -> Picture:
        """Return the method's own picture of a view; see ``scoup.view.exact.draw_picture``."""
        answers = self._chosen_answers(texts, level, threshold, always) if texts else []
        return draw_picture(self.view_of(camera), mode, answers, colors, opacity, level)

    def what_is_at(self, camera: Camera, pixel: tuple[int, int]) -> dict[str, Any]:
        """Return the position and words at a pixel; see ``scoup.view.exact.what_is_at``."""
        return what_is_at(self.view_of(camera), self.codes.confidence, pixel, self.vocabulary())

    def view_of(self, camera: Camera) -> FieldView:
        """Return the field as a camera sees it; the last view is kept."""
        if self._view is None or self._view.camera.fingerprint() != camera.fingerprint():
            self._view = self.field.at(camera)
        return self._view

    def selection(
        self,
        texts: Sequence[str],
        level: int | None = None,
        threshold: float | None = None,
        rest: bool = False,
        always: bool = False,
    ) -> PlyTable:
        """Return the Gaussians that answer any of the texts, or all others, as `scoup select` writes them."""
        answers = self._chosen_answers(texts, level, threshold, always)
        chosen = torch.stack([answer.mask for answer in answers]).any(0)
        return self._table(~chosen if rest else chosen)

    def _chosen_answers(
        self, texts: Sequence[str], level: int | None, threshold: float | None, always: bool
    ) -> list[Answer]:
        """Return the answers to texts; without a level of choice, a threshold leaves the level that answers."""
        if threshold is None or level is not None:
            return self.field.answer(self.question(texts, always, level=level, threshold=threshold))
        levels = [answer.asked.level for answer in self.field.answer(self.question(texts, always))]
        return [
            self.field.answer(self.question([text], always, level=best, threshold=threshold))[0]
            for text, best in zip(texts, levels, strict=True)
        ]

    def things(self) -> list[dict[str, Any]]:
        """Return every thing as plain JSON values, with its name, or None."""
        rows = []
        for thing in named_things(self.field, self.vocabulary()):
            record = thing.to_dict()
            row = {
                "number": thing.number,
                "level": self.field.level_index(thing.level),
                "parent": thing.parent,
            }
            facts = {name: record[name] for name in ("position", "box", "gaussians")}
            name = {"name": thing.text or None, "named_by": thing.named_by}
            rows.append({**row, **name, **facts, "views": thing.n_regions})
        return rows

    def things_selection(self, names: Mapping[int, str], rest: bool = False) -> PlyTable:
        """Return the Gaussians of things by their numbers, or all others; the header contains the names of the
        things."""
        table = self.field.thing_table
        count = 0 if table is None else len(table)
        wrong = [number for number in names if not 0 <= number < count]
        if table is None or wrong:
            raise InputError(f"there is no thing {wrong[0] if wrong else 0}; this field has {count:,} things")
        chosen = torch.isin(table.owners.cpu(), torch.tensor(list(names), dtype=torch.int32)).any(1)
        comments = tuple(f"thing {number}: {name}" for number, name in names.items())
        selected = self._table(~chosen if rest else chosen)
        return replace(selected, comments=(*selected.comments, *comments))

    def _table(self, chosen: torch.Tensor) -> PlyTable:
        if not chosen.any():
            raise InputError("no Gaussian is selected; try a lower threshold, or another text")
        return SplatTable.of(self.field).select(chosen)

    def thumbnail(self, camera: Camera) -> Picture:
        """Return a small picture of a view, [H, ``THUMBNAIL_WIDTH``, 3] uint8."""
        height = max(1, round(camera.height * THUMBNAIL_WIDTH / camera.width))
        small = camera.resized(THUMBNAIL_WIDTH, min(height, 4 * THUMBNAIL_WIDTH))
        return as_picture(self.field.at(small).renders.colors())

    @cached_property
    def _probe(self) -> list[str]:
        """A text that can be asked."""
        names = self.field.encoder.names
        return [names[0] if names else "object"]


def _is_file(name: str) -> bool:
    """Return whether a name is that of a file, not the id of a model."""
    return WordTable.is_meant(name) or Path(name).is_absolute() or name.endswith(".scoup")
