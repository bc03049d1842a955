"""Requests of visitors, read from untrusted JSON."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import torch

from scoup.base import InputError
from scoup.scene import Camera
from scoup.view.exact import LARGEST_SIDE

MOST_TEXTS = 8
MOST_THINGS = 1000
LONGEST_TEXT = 200
_QUALITIES = (1, 95)


@dataclass(frozen=True)
class Message:
    """The fields of a request; methods raise InputError if a field is missing, of another type or out of range."""

    fields: dict[str, Any]  # as they came

    def texts(self, least: int = 1) -> list[str]:
        """Return the texts in "texts", ``MOST_TEXTS`` at most; a missing field has none."""
        texts = self.fields.get("texts", [])
        if not isinstance(texts, list) or not least <= len(texts) <= MOST_TEXTS:
            raise InputError(f"pass {least} to {MOST_TEXTS} texts to look for")
        return [_checked_text(text) for text in texts]

    def colors(self) -> list[tuple[float, float, float]]:
        """Return the colours of the texts in "colors", 0..255; a missing field has none."""
        colors = self.fields.get("colors", [])
        if not isinstance(colors, list) or len(colors) > MOST_TEXTS:
            raise InputError(f"pass at most {MOST_TEXTS} colors")
        if not all(isinstance(color, list) and len(color) == 3 for color in colors):
            raise InputError("a color has 3 numbers")
        numbers = [[_number(value, "color", 0, 255) for value in color] for color in colors]
        return [(red, green, blue) for red, green, blue in numbers]

    def opacity(self) -> float:
        """Return the opacity of the colours, 0 to 1; 1 if the field is missing."""
        return _number(self.fields.get("opacity", 1.0), "opacity", 0, 1)

    def things(self) -> dict[int, str]:
        """Return the names, by number, of the things in "things"; none if the field is missing."""
        things = self.fields.get("things", [])
        if not isinstance(things, list) or len(things) > MOST_THINGS:
            raise InputError(f"select at most {MOST_THINGS:,} things")
        names = {}
        for thing in things:
            number = thing.get("number") if isinstance(thing, dict) else None
            if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < 65535:
                raise InputError("a thing has a number and a name")
            names[number] = _checked_text(thing.get("name"))
        return names

    def level(self, count: int) -> int | None:
        """Return the position of a level among ``count``; None if there is none."""
        level = self.fields.get("level")
        if level is None:
            return None
        if not isinstance(level, int) or isinstance(level, bool) or not 0 <= level < count:
            raise InputError(f"the level must be 0 to {count - 1}")
        return level

    def threshold(self) -> float | None:
        """Return the threshold, 0 to 1; None if there is none."""
        threshold = self.fields.get("threshold")
        return None if threshold is None else _number(threshold, "threshold", 0, 1)

    def flag(self, name: str) -> bool:
        """Return whether a field is true; False if it is missing."""
        value = self.fields.get(name, False)
        if not isinstance(value, bool):
            raise InputError(f"{name!r} must be true or false")
        return value

    def quality(self, default: int = 85) -> int:
        """Return the quality of a JPEG."""
        return round(_number(self.fields.get("quality", default), "quality", *_QUALITIES))

    def camera(self) -> Camera:
        """Return the camera in "camera"; its sides are at most ``LARGEST_SIDE``."""
        record = self.fields.get("camera")
        if not isinstance(record, dict):
            raise InputError("the camera is missing")
        viewmat, K = _numbers(record, "viewmat", 16), _numbers(record, "K", 9)
        width, height = (_side(record, name) for name in ("width", "height"))
        matrix = torch.tensor(viewmat, dtype=torch.float64).reshape(4, 4)
        return Camera("view", matrix, torch.tensor(K, dtype=torch.float64).reshape(3, 3), width, height)

    def pixel(self) -> tuple[int, int]:
        """Return (x, y) in "pixel"."""
        x, y = _numbers(self.fields, "pixel", 2)
        return math.floor(x), math.floor(y)


def _number(value: Any, name: str, least: float, most: float) -> float:
    if not _is_number(value) or not least <= value <= most:
        raise InputError(f"{name!r} must be {least:g} to {most:g}")
    return float(value)


def _checked_text(text: Any) -> str:
    if not isinstance(text, str) or not text.strip() or len(text) > LONGEST_TEXT:
        raise InputError(f"a text must have 1 to {LONGEST_TEXT} characters")
    if any("\ud800" <= letter <= "\udfff" for letter in text):  # JSON can escape half a character
        raise InputError("a text must be valid Unicode, without lone surrogates")
    return " ".join(text.split())


def _numbers(record: dict[str, Any], name: str, count: int) -> list[float]:
    values = record.get(name)
    if not isinstance(values, list) or len(values) != count or not all(map(_is_number, values)):
        raise InputError(f"{name!r} must be {count} numbers")
    return [float(value) for value in values]


def _side(record: dict[str, Any], name: str) -> int:
    value = record.get(name)
    if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= LARGEST_SIDE:
        raise InputError(f"{name!r} must be 1 to {LARGEST_SIDE} pixels")
    return value


def _is_number(value: Any) -> bool:
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_number and abs(value) < 1e30  # also refuses what is not a number
