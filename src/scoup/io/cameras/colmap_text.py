"""The text files of a COLMAP model."""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from scoup.base import FileFormatError, existing_file
from scoup.io.cameras.colmap_model import PARAMETER_COUNTS, Lens, Points, Shot
from scoup.io.reading import read_text

_NUMBER = re.compile(r"-?\d{1,18}(\.0*)?")
_REMEDY = "the file is cut short or damaged; copy or export it again"


def read_lenses(path: Path) -> dict[int, Lens]:
    """Read cameras.txt: lenses by number."""
    lenses = {}
    for number, line in _lines(path):
        if not line:
            continue
        words = line.split()
        try:
            identifier, model, width, height = _whole(words[0]), words[1], _whole(words[2]), _whole(words[3])
            parameters = tuple(float(word) for word in words[4:])
        except (ValueError, IndexError) as error:
            raise _damaged(path, number) from error
        if len(parameters) != PARAMETER_COUNTS.get(model, len(parameters)):
            raise _damaged(path, number)
        lenses[identifier] = Lens(model, width, height, parameters)
    return lenses


def read_shots(path: Path) -> list[Shot]:
    """Read images.txt; lines of keypoints are skipped."""
    shots = []
    for number, words in _image_lines(path):
        try:
            values = [float(word) for word in words[1:8]]
            number_of_image, lens = _whole(words[0]), _whole(words[8])
            shots.append(Shot(number_of_image, words[9], lens, tuple(values[:4]), tuple(values[4:])))
        except (ValueError, IndexError) as error:
            raise _damaged(path, number) from error
    return shots


def read_points(path: Path) -> Points:
    """Read points3D.txt."""
    positions: list[list[float]] = []
    colors: list[list[int]] = []
    lengths: list[int] = []
    images = array("q")
    for number, line in _lines(path):
        if not line:
            continue
        words = line.split()
        try:
            positions.append([float(word) for word in words[1:4]])
            colors.append([_whole(word) for word in words[4:7]])
            images.extend(_whole(word) for word in words[8::2])
        except (ValueError, OverflowError) as error:
            raise _damaged(path, number) from error
        if len(colors[-1]) != 3 or not all(0 <= value <= 255 for value in colors[-1]):
            raise _damaged(path, number)
        lengths.append(len(words[8::2]))
    return Points(
        np.array(positions).reshape(-1, 3),
        np.array(colors, np.uint8).reshape(-1, 3),
        np.array(lengths, np.int64),
        np.array(images, np.int64),
    )


def _whole(word: str) -> int:
    """Return a whole number, which some programs write as 1.0; a ValueError for others."""
    if _NUMBER.fullmatch(word):
        return int(word.partition(".")[0])
    return int(word)


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Return numbered lines without comments; empty ones are kept (in images.txt: an image without keypoints)."""
    text = read_text(existing_file(path, "a file of a COLMAP model"))
    for number, line in enumerate(map(str.strip, text.split("\n")), start=1):
        if not line.startswith("#"):
            yield number, line


def _image_lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Return the words of images, name last. After each follow keypoints, perhaps none, or at once the next image."""
    after_image = False
    for number, line in _lines(path):
        words = line.split(maxsplit=9)
        # Keypoints are triples that end in the number of a point, images end in a name, perhaps a number too.
        last = words[-1].split() if words else []
        keypoints = bool(last) and bool(_NUMBER.fullmatch(last[-1]))
        keypoints &= len(words) < 10 or (len(words) - 1 + len(last)) % 3 == 0
        after_image = bool(words) and not (after_image and keypoints)
        if after_image:
            yield number, words


def _damaged(path: Path, number: int) -> FileFormatError:
    return FileFormatError(path, f"line {number} is not in COLMAP's format", _REMEDY)
