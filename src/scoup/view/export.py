"""A page that needs no server: one HTML file to mail, or a folder of files."""

from __future__ import annotations

import base64
import hashlib
import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from PIL import Image

from scoup.base import (
    Progress,
    atomic_path,
    check_output,
    no_progress,
    reported,
    reserved_output,
    staged,
)
from scoup.pictures import Picture
from scoup.view.page import page_files, script_text
from scoup.view.scene_answers import scene_answers
from scoup.view.viewed_field import ViewedField
from scoup.view.vocabulary import words_data

MOST_THUMBNAILS = 24
THUMBNAIL_QUALITY = 70
FOLDER_FILES = ("index.html", "scene.js", "words.js", "thumbnails.js")


@dataclass(frozen=True)
class ExportReport:
    """Sizes of an exported page."""

    out: Path  # the file or folder
    bytes: int  # of all of it
    scene_bytes: int  # splat and codes, compressed
    words_bytes: int  # the vocabulary, compressed
    words: int  # how many can be asked


def export_page(
    viewed: ViewedField,
    out: str | Path,
    split: bool = False,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> ExportReport:
    """Write a page that needs neither server nor network: the HTML file ``out``, or with ``split`` a folder, whose
    ``index.html`` loads the data beside it. Parts of an earlier page in the folder go when it is overwritten.

    Texts and phrases over the field's vocabulary can be asked: the answer to each word lies in the page, the inner
    products of word and atoms (2 bytes each), level, thresholds, score and presence; and the relations of things.
    """
    out = Path(out)
    part_files = [f"part_{number}.js" for number in range(viewed.n_parts)]
    names = (*FOLDER_FILES, *part_files)
    check_output(*(out / name for name in names) if split else (out,), overwrite=overwrite)
    # One process at a time does the work.
    with reserved_output(out / names[0] if split else out, overwrite):
        return _export(viewed, out, names if split else (), overwrite, progress)


def _export(
    viewed: ViewedField, out: Path, names: Sequence[str], overwrite: bool, progress: Progress
) -> ExportReport:
    """Write the files ``names`` in a folder; without any, a single file."""
    files, settings = page_files(), viewed.settings("exported")
    words, count = _words(viewed, progress)
    first = viewed.scene(effort=9, exported=True)
    thumbnails = _thumbnails(viewed, progress)
    data = {"scene": _base64(first), "words": _base64(words), "thumbnails": thumbnails}
    scene_bytes = len(first)

    def encoded_part(number: int) -> str:
        nonlocal scene_bytes
        packed = viewed.part(number, effort=9)
        scene_bytes += len(packed)
        return _base64(packed)

    if names:
        # Scripts of another export, or of an earlier one in a cache, assign to another name.
        mark = hashlib.sha256(script_text(data).encode()).hexdigest()[:16]
        target = f"window.scoup_{mark}"
        tags = "\n".join(f'<script src="{name}.js?{mark}"></script>' for name in data)
        begin = f'<script>window.scoupData = {target} = {{mark: "{mark}", parts: []}};</script>'
        html = files.in_one(settings, f"{begin}\n{tags}")
        old = [part for part in out.glob("part_[0-9]*.js") if overwrite and part.name not in names]
        with staged(out, names, overwrite, old) as hidden:
            (hidden / "index.html").write_text(html, encoding="utf-8")
            # One part after another, as the page loads them.
            parts = ((f"parts[{number}]", encoded_part(number)) for number in range(viewed.n_parts))
            for file, (name, value) in zip(names[1:], chain(data.items(), parts), strict=True):
                (hidden / file).write_text(_assignment(f"{target}.{name}", value), encoding="utf-8")
        size = sum((out / name).stat().st_size for name in names)
    else:
        whole = {**data, "parts": [encoded_part(number) for number in range(viewed.n_parts)]}
        html = files.in_one(settings, f"<script>{_assignment('window.scoupData', whole)}</script>")
        with atomic_path(out, overwrite) as temporary:
            temporary.write_text(html, encoding="utf-8")
        size = out.stat().st_size
    return ExportReport(out, size, scene_bytes, len(words), count)


def jpeg(picture: Picture, quality: int = THUMBNAIL_QUALITY) -> bytes:
    """Return a picture [H, W, 3] uint8 as a JPEG."""
    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "JPEG", quality=quality)
    return stream.getvalue()


def _words(viewed: ViewedField, progress: Progress) -> tuple[bytes, int]:
    """Return the file of words, empty if no text can be asked, and how many there are."""
    vocabulary = viewed.vocabulary()
    if vocabulary is None:
        return b"", 0
    pending = scene_answers(viewed.field, vocabulary)
    answers = [*reported(pending, "words", len(vocabulary.texts), progress)]
    return words_data(viewed.field, vocabulary, answers), len(answers)


def _thumbnails(viewed: ViewedField, progress: Progress) -> Sequence[str | None]:
    """Return JPEGs of evenly spread cameras as base64; None for the others."""
    cameras = list(viewed.field.cameras or ())
    step = max(1, -(-len(cameras) // MOST_THUMBNAILS))
    thumbnails: list[str | None] = []
    for number, camera in enumerate(reported(cameras, "pictures", len(cameras), progress)):
        thumbnails.append(None if number % step else _base64(jpeg(viewed.thumbnail(camera))))
    return thumbnails


def _assignment(target: str, value: Any) -> str:
    return f"{target} = {script_text(value)};\n"


def _base64(data: bytes) -> str:
    return base64.b64encode(data).decode()
