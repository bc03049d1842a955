"""Values of a JSON file that know their place in it: readers state keys and types, errors name file and place."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scoup.base.errors import FileFormatError

if TYPE_CHECKING:
    import numpy as np

_EXACT = 2**53  # beyond it JSON numbers are not exact; no count or size of a file comes near


@dataclass(frozen=True)
class JsonNode:
    """A value in a JSON file. What asks for a type raises a FileFormatError if the value has another.

    Example:
        >>> file = JsonNode(Path("a.json"), {"frames": [{"w": 64}]})
        >>> [frame.get("w").whole(low=1) for frame in file.get("frames").items()]
        [64]
    """

    path: Path
    value: Any  # None if it is missing
    remedy: str = "the file is damaged"
    place: str = ""  # such as frames[0].w; "" for the whole file

    def get(self, key: str) -> JsonNode:
        """Return the value of a key of this object; its own value is None if the key is missing."""
        location = f"{self.place}.{key}" if self.place else key
        return replace(self, value=self.object().get(key), place=location)

    def items(self) -> list[JsonNode]:
        if not isinstance(self.value, list):
            raise self.error("a list")
        return [
            replace(self, value=item, place=f"{self.place}[{number}]")
            for number, item in enumerate(self.value)
        ]

    def object(self) -> dict[str, Any]:
        if not isinstance(self.value, dict):
            raise self.error("an object")
        return self.value

    def text(self, choices: Sequence[str] = ()) -> str:
        """Return a string, which must be one of the choices if there are any, and otherwise not be empty."""
        if not isinstance(self.value, str) or not (self.value in choices if choices else self.value.strip()):
            raise self.error(" or ".join(choices) if choices else "a text")
        return self.value

    def number(self, default: float | None = None) -> float:
        """Return a finite number; the default if it is missing."""
        value = default if self.value is None else self.value
        if isinstance(value, (int, float)) and not isinstance(value, bool):
            try:
                result = float(value)
            except OverflowError:
                result = math.inf
            if math.isfinite(result):
                return result
        raise self.error("a finite number")

    def whole(self, low: int = 0, high: int = _EXACT, default: int | None = None) -> int:
        """Return a whole number from ``low`` to ``high``; the default if it is missing."""
        value = default if self.value is None else self.value
        if isinstance(value, float) and value.is_integer():
            value = int(value)
        if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
            raise self.error(f"a whole number from {low}" + (f" to {high}" if high < _EXACT else ""))
        return value

    def numbers(self, *shape: int) -> np.ndarray:
        """Return nested lists as a float64 array of this shape, all finite."""
        import numpy as np

        return np.array(list(self._walk(shape)), np.float64).reshape(shape)

    def _walk(self, shape: tuple[int, ...]) -> Iterator[float]:
        if not shape:
            yield self.number()
            return
        if not isinstance(self.value, list) or len(self.value) != shape[0]:
            raise self.error(f"{' x '.join(map(str, shape))} numbers")
        for item in self.items():
            yield from item._walk(shape[1:])

    def error(self, expected: str) -> FileFormatError:
        """Return the error of a value other than the expected one."""
        what = self.place or "its content"
        return FileFormatError(self.path, f"{what} is {_short(self.value)}, expected {expected}", self.remedy)


def _short(value: Any) -> str:
    if isinstance(value, (list, dict)):
        return f"{'a list' if isinstance(value, list) else 'an object'} of {len(value)}"
    text = "missing" if value is None else ascii(value)
    return text if len(text) <= 40 else text[:37] + "..."
