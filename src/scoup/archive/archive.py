"""An archive: scans that are added, removed and asked together."""

from __future__ import annotations

import heapq
import json
import re
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import lru_cache
from importlib.util import find_spec
from itertools import groupby, islice
from pathlib import Path
from threading import Lock
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray
from PIL import Image, ImageOps
from torch import Tensor

from scoup.archive.database import WHERE_SECONDS, connect, matching_things
from scoup.archive.found_things import FoundThing, FoundThings
from scoup.archive.kept_scans import KeptScans, free_row, vector_bytes
from scoup.archive.scan_files import Scan, arrays_of, read_places, write_scan
from scoup.archive.scan_header import check_columns, check_folder, file_of, scan_names
from scoup.archive.search import (
    AskedScans,
    Encode,
    Found,
    UnaskedScanError,
    look_alikes,
    parse_search,
    words_digest,
)
from scoup.base import (
    FileFormatError,
    InputError,
    MissingFileError,
    OutputExistsError,
    ScoupError,
    ScoupWarning,
    check_arguments,
    check_format_version,
    looked_up,
    write_text,
)
from scoup.field import place_of, relative_place
from scoup.io import open_image, rgb_image
from scoup.models import Encoder, TextEncoder
from scoup.query import AskedThings, LanguageField, Thing, ThingIndex, warn_of_another_model

if TYPE_CHECKING:
    from duckdb import DuckDBPyConnection

FORMAT, VERSION, ABOUT = "scoup archive", 1, "archive.json"
Wanted: TypeAlias = "Mapping[int, set[int] | None]"
"""Number of a scan -> its things that may be found; None: all. Scans without any are left out."""
ENCODED = 16  # lists of names whose vectors are in memory


class Archive:
    """A folder with a Parquet file per scan, the matrix of all vectors, and ``archive.json``, which names the embedding
    model.

    Args:
        folder: made when the first scan is added.
        encoder: of texts; by default the word table or model that the field added first names.
        where_seconds: time limit of a condition (`where`), which also has one of 4 GB of memory.

    Raises:
        MissingFileError, FileFormatError: ``archive.json`` is missing or damaged.
        ScoupError: DuckDB is not installed.

    Example:
        >>> archive = scoup.Archive("scans", encoder="scene/words.npz")
        >>> archive.add("f.scoup", floor=2)
        >>> found = archive.find("kettle", where="floor = 2")[0]
        >>> found.scan, found.position.shape, len(found.field())
        ('f', torch.Size([3]), 150)
        >>> archive.find("kettle", where="floor = 3")
        []
        >>> archive.remove("f")
        >>> archive.scans()
        {}
    """

    def __init__(
        self, folder: str | Path, encoder: Encoder | None = None, where_seconds: float = WHERE_SECONDS
    ) -> None:
        check_arguments("Archive", folder=(folder, Path))
        self.folder, self._where_seconds = Path(folder), where_seconds
        check_folder(self.folder)
        self._encoder: Encoder | None = encoder
        self._embedder: Any = None
        self._asking = Lock()  # of encoders, which threads cannot share; conditions do not wait for it
        self._cached: Any = (None, None)
        self._connection: DuckDBPyConnection | None = None
        if find_spec("duckdb") is None:
            connect()  # says what to install
        self._kept = KeptScans(self.folder, self._cursor)
        self._about()

    def scans(self) -> dict[str, Scan]:
        """Return the scans by name.

        Raises:
            FileFormatError: a file is damaged; the error names it.
        """
        return self._kept.ask(dict)

    def add(self, field: LanguageField | str | Path, **columns: str | int | float) -> None:
        """Add a field as the scan that has the name of its file; the scan of that name is replaced.

        Args:
            field: a saved field with things, or its file.
            columns: of the scan, for conditions, such as ``floor=2``. A replaced scan keeps those not given.

        Raises:
            InputError: the field has no things or is not saved, its embedding model is not that of the archive, a
                scan of this name is of another field, or a column cannot be kept.
            MissingFileError, FileFormatError, WriteError: the field cannot be read, or the scan not be written.
        """
        check_columns(columns)
        field = field if isinstance(field, LanguageField) else LanguageField.load(field)
        if field.path is None or field.thing_table is None:
            lack = "has no things; build it again" if field.path else "is not saved; save it first"
            raise InputError(f"{field.path or 'this field'}: {lack}")
        path, name = field.path.absolute(), field.path.stem
        if not re.fullmatch(r"\w[\w .+-]{0,99}", name):
            raise InputError(
                f"{path}: a scan is named by letters, digits, spaces, _ . + and -; rename the field"
            )
        about, file = self._check_model(field), file_of(self.folder, name)
        encoder = self.text_encoder(field)
        index = ThingIndex.of_field(field, encoder)
        if index is None:
            raise InputError(f"{path}: has no things; build it again")
        table = field.thing_table.to("cpu")
        things = Thing.of_table(field, range(len(table)))
        placed = torch.zeros(len(table), dtype=torch.bool)
        placed[[thing.number or 0 for thing in things]] = True
        vectors = vector_bytes(table.embeddings)
        if not self._about():
            with suppress(OutputExistsError):  # another process has added its first scan
                write_text(self.folder / ABOUT, json.dumps(about, indent=1) + "\n", wait=True)
            self._check_model(field)
        with self._kept.writing() as scans:
            if (old := scans.get(name)) is not None:
                if old.field_path != path and old.field_path.exists():
                    problem = f"the scan {name} of this archive is of {old.field_path}"
                    raise InputError(f"{path}: {problem}; rename one of the fields")
                columns = {**old.columns, **columns}
            row = free_row(scans.values(), len(table))
            self._kept.write_vectors(vectors, row, field.dim)
            scan = Scan(
                file=file,
                field=relative_place(file.resolve(), path) or "",
                levels=field.levels,
                columns=columns,
                world=field.world,
                row=row,
                vectors_checksum=zlib.crc32(vectors),
                words=words_digest(index.words),
                texts=() if table.names is None else table.names.texts,
                arrays=arrays_of(index, table.names, placed),
            )
            write_scan(scan, table, things)

    def remove(self, name: str) -> None:
        """Remove a scan; its field stays.

        Raises:
            UnknownNameError: there is no such scan.
        """
        file = looked_up("scan", name, {scan: file_of(self.folder, scan) for scan in scan_names(self.folder)})
        with self._kept.writing():
            file.unlink(missing_ok=True)

    def find(
        self,
        question: str,
        where: str | None = None,
        top: int = 20,
        at_least: int | None = None,
        present_from: float | None = None,
    ) -> FoundThings:
        """Return the things of all scans that answer a text or phrase, best first: by their score and by how much they
        fit it better than everyday words do.

        In each scan, the things of ``field.things(question)`` answer. Fields are loaded for phrases ("mug left of the
        laptop") and for texts joined by `and` or `not`, and only where everything that they name is present.

        Args:
            question: as of ``LanguageField.things``.
            where: a condition in SQL over the columns of the Parquet files: "floor = 2 and gaussians > 100".
            top: most things; with ``at_least``, most scans.
            at_least: only scans with so many things that answer, those with the most first, each with all of these.
            present_from: as of ``LanguageField.question``.

        Raises:
            InputError: the question or condition cannot be used, or nothing is found and a field cannot be asked.
            FileFormatError: a file is damaged; the error names it.
        """
        check_arguments(
            "Archive.find",
            top=(top, int),
            at_least=(at_least, (int, type(None))),
            where=(where, (str, type(None))),
        )
        for name, number in (("top", top), ("at_least", at_least)):
            if number is not None and number < 1:
                raise InputError(f"`{name}` must be 1 or more, got {number}")
        with self._asking:
            encoder = self.text_encoder()
            encode = self._encode(encoder)
            expression, asked = parse_search(question, encoder, present_from)

        def best(scans: dict[str, Scan], wanted: Wanted) -> tuple[list[Found], int | None]:
            index = self._kept.index(scans, asked.compared, words_digest(asked.compared))
            things = AskedThings(index, asked, [scan.names for scan in scans.values()], encoder, encode)
            asked_scans = AskedScans(expression, things, [*scans.values()])
            answers, n_answers = self._answers(asked_scans, wanted, None if at_least else top)
            if at_least is not None:
                of_scan = [[*group] for _, group in groupby(answers, lambda answer: answer.scene)]
                of_scan.sort(key=len, reverse=True)
                answers = [answer for group in of_scan[:top] if len(group) >= at_least for answer in group]
            return answers, n_answers

        return self._ask(where, best)

    def find_image(
        self, image: str | Path | Image.Image, where: str | None = None, top: int = 20
    ) -> FoundThings:
        """Return the things of all scans that look most like an image, best first; their score is the cosine with it.

        Whether any shows the same is not judged.

        Args:
            image: a file or an image of Pillow, of one object, as large as the picture if possible.
            where: as of ``find``.
            top: most things.

        Raises:
            InputError, ScoupError: the embedding model of the archive cannot embed images, or not be opened.
            MissingFileError, FileFormatError: the image, or a scan, cannot be read.
        """
        if top < 1:
            raise InputError(f"`top` must be 1 or more, got {top}")
        if isinstance(image, Image.Image):
            name, pixels = "image", _pixels(image)
        else:
            name = Path(image).name
            with open_image(Path(image)) as opened:
                pixels = _pixels(opened)
        with self._asking:
            vector = self._embedded(pixels)

        def best(scans: dict[str, Scan], wanted: Wanted) -> tuple[list[Found], int | None]:
            index = self._kept.index(scans, vector[None], "")
            placed = [scan.arrays["placed"] for scan in scans.values()]
            alike = look_alikes(index, vector, name, placed)
            return [*islice((answer for answer in alike if _is_wanted(answer, wanted)), top)], None

        return self._ask(where, best)

    def text_encoder(self, field: LanguageField | None = None) -> TextEncoder:
        """Return the encoder of texts, opened on first use; ``field`` names one while the archive has no scan.

        Raises:
            InputError: none is named, or its vectors have another size.
            MissingFileError, FileFormatError, ScoupError: it cannot be opened (``TextEncoder.open``).
        """
        about, source = self._about(), self._encoder
        if source is None and about:
            source = place_of(self.folder / ABOUT, about["words"]) or about["embedding_model"]
            if isinstance(source, Path) and not source.is_file():
                problem = f"is missing, and the archive {self.folder} names it as its word table"
                raise MissingFileError(source, problem, "pass its new path as `encoder`")
        elif source is None and field is not None:
            source = field.encoder_source
        if not source and about:
            remedy = "pass a word table or model as `encoder`"
            raise InputError(f"{self.folder}: does not say what encodes texts; {remedy}")
        if not source or not (about or field):  # or it has disappeared
            raise self._empty()
        opened = source if isinstance(source, TextEncoder) else TextEncoder.open(source)
        if about and opened.dim != about["dim"]:
            raise InputError(
                f"{opened.name or 'the word table'}: has vectors of {opened.dim} dimensions, the archive {self.folder} "
                f"contains {_embeddings(about['embedding_model'], about['dim'])}; pass a word table or model of these"
            )
        warn_of_another_model(opened.name, about.get("embedding_model", ""), opened.name)
        self._encoder = opened
        return opened

    def _cursor(self) -> DuckDBPyConnection:
        """Return a cursor of the one connection, which is opened on first use."""
        if self._connection is None:
            self._connection = connect()
        return self._connection.cursor()

    def _about(self) -> dict[str, Any]:
        """Return the contents of archive.json; empty before the first scan."""
        path = self.folder / ABOUT
        if path.exists() and not path.is_file():
            raise MissingFileError.of(path, "the description of an archive", "move it")
        try:
            about = json.loads(path.read_text(encoding="utf-8"))
            if about["format"] != FORMAT:
                raise ValueError(f"it is of the format {about['format']!r:.50}")
            check_format_version(path, about["version"], VERSION)
            words, model = about["words"], str(about["embedding_model"])
            if not isinstance(words, str | None):
                raise TypeError(f"its words are {words!r:.50}")
            return {"dim": int(about["dim"]), "embedding_model": model, "words": words}
        except FileNotFoundError as error:
            if scan_names(self.folder):
                problem = "there is no such file beside the Parquet files"
                raise MissingFileError(path, problem, "restore it, or use another folder") from error
            return {}
        except OSError as error:
            raise FileFormatError.unreadable(path, error) from error
        except (ValueError, LookupError, TypeError, OverflowError, RecursionError) as error:
            if isinstance(error, ScoupError):
                raise
            remedy = "restore it, or add the fields to a new archive"
            raise FileFormatError(path, f"does not describe an archive ({error})", remedy) from error

    def _check_model(self, field: LanguageField) -> dict[str, Any]:
        """Refuse a field of another embedding model; return the present or future contents of archive.json."""
        words = relative_place(self.folder.resolve() / ABOUT, field.info.words)
        model = {"embedding_model": field.embedding_model, "dim": field.dim}
        about = self._about() or {"format": FORMAT, "version": VERSION, **model, "words": words}
        if model != {name: about[name] for name in model}:
            problem = f"contains {_embeddings(**model)}, the archive {self.folder} {_embeddings(**about)}"
            raise FileFormatError(field.path or self.folder, problem, "use an archive per embedding model")
        return about

    def _encode(self, encoder: TextEncoder) -> Encode:
        """Return ``encoder.encode`` with a cache."""
        if encoder is not self._cached[0]:
            self._cached = encoder, lru_cache(ENCODED)(encoder.encode)
        return self._cached[1]

    def _empty(self) -> InputError:
        problem = "contains no scan" if self.folder.is_dir() else "there is no such archive"
        return InputError(f"{self.folder}: {problem}; add fields first")

    def _embedded(self, pixels: NDArray[np.uint8]) -> Tensor:
        """Return the vector [D] of an image [H, W, 3] by the embedding model of the archive."""
        from scoup.extract import embed_image, open_embedder

        about = self._about()
        if not about:
            raise self._empty()
        try:
            self._embedder = self._embedder or open_embedder(about["embedding_model"])
            if self._embedder.dim != about["dim"]:
                raise InputError(f"it has {self._embedder.dim} dimensions")
        except ScoupError as error:
            reason = str(error).partition(";")[0]
            problem = f"contains {_embeddings(**about)}, and its model embeds no image here ({reason})"
            raise InputError(f"{self.folder}: {problem}; ask with a text") from error
        return embed_image(pixels, self._embedder)

    def _answers(self, asked: AskedScans, wanted: Wanted, top: int | None) -> tuple[list[Found], int | None]:
        """Return the things that answer and are wanted, with ``top`` the best; and how many there are, if all scans
        were asked.

        Scans whose fields cannot be asked are left out with a warning; an error if nothing is found in the others.
        """
        answers: list[Found] = []
        n_answers: int | None = 0
        unasked: list[UnaskedScanError] = []
        for bound, ask in asked.batches():
            if top is not None and len(answers) >= top and min(answer.rank for answer in answers) >= bound:
                n_answers = None
                break  # all later ones are lower
            try:
                new = [answer for answer in ask() if _is_wanted(answer, wanted)]
                answers, n_answers = answers + new, n_answers + len(new)
            except UnaskedScanError as error:
                unasked.append(error)
            if top is not None:
                answers = heapq.nlargest(top, answers, key=lambda answer: answer.rank)
        fatal = unasked.pop() if unasked and not answers else None
        for error in unasked:
            warnings.warn(str(error), ScoupWarning, stacklevel=7)
        if fatal is not None:
            raise fatal
        return answers, n_answers

    def _wanted(self, where: str | None, scans: Mapping[str, Scan]) -> Wanted:
        """Return by number the scans with things for which a condition holds, and these things."""
        if where is None or not scans:
            return dict.fromkeys(range(len(scans)))
        files = [scan.file for scan in scans.values()]
        things = matching_things(where, files, self.folder, self._where_seconds)
        paths = (str(file.absolute()) for file in files)
        return {number: set(things[path]) for number, path in enumerate(paths) if path in things}

    def _ask(
        self, where: str | None, best: Callable[[dict[str, Scan], Wanted], tuple[list[Found], int | None]]
    ) -> FoundThings:
        """Return the best answers, and how many there are if that is known, of scans and wanted things."""

        def find_in(scans: dict[str, Scan]) -> FoundThings:
            if not (wanted := self._wanted(where, scans)):
                return FoundThings()
            with self._asking:
                answers, n_answers = best(scans, wanted)
                found = self._found(scans, answers)
                found.n_answers = n_answers
                return found

        return self._kept.ask(find_in, lambda things: (thing.scan for thing in things))

    def _found(self, scans: Mapping[str, Scan], answers: Sequence[Found]) -> FoundThings:
        """Return things with their places."""
        of_scene = [*scans.values()]
        places = read_places([(of_scene[one.scene], one.thing) for one in answers], self._cursor())
        return FoundThings(
            FoundThing(
                scan.name, one.thing, one.text, scan.levels[int(scan.arrays["levels"][one.thing])], one.score,
                one.certainty, position, box, int(scan.arrays["counts"][one.thing]), scan.columns, scan.field_path,
                scan.world, one.runner_up,
            )
            for one, (position, box) in zip(answers, places, strict=True)
            for scan in [of_scene[one.scene]]
        )  # fmt: skip


def _is_wanted(answer: Found, wanted: Wanted) -> bool:
    things = wanted.get(answer.scene, ())
    return things is None or answer.thing in things


def _pixels(image: Image.Image) -> NDArray[np.uint8]:
    """Return [H, W, 3] of an image, the right way up."""
    return np.array(rgb_image(ImageOps.exif_transpose(image)))


def _embeddings(embedding_model: str, dim: int, **_: Any) -> str:
    """Describe the embeddings of a field."""
    return f"embeddings of {embedding_model or 'an unnamed model'} ({dim} dimensions)"
