"""The one cache: values that the next question to a field, or to one of its views, uses again."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import fields, is_dataclass
from typing import Any, TypeAlias, TypeVar

from torch import Tensor

Value = TypeVar("Value")
Parts: TypeAlias = Sequence[object]
"""Sources of values: tensors, and objects that do not change."""
State: TypeAlias = tuple[tuple[object, int], ...]

ENTRY_BYTES = 512
"""Counted for every entry, besides its tensors."""


class Cache:
    """Values by key, of at most ``most_bytes`` together; those used longest ago go first.

    A field owns one, each of its views another. It is emptied once a part that its values are made from is replaced or
    written to. Threads may share it. Copies start empty.

    Example:
        >>> cache = Cache(most_bytes=1 << 20)
        >>> cache.value("zeros", lambda: torch.zeros(2)), cache.value("zeros", lambda: torch.ones(2))
        (tensor([0., 0.]), tensor([0., 0.]))
    """

    def __init__(self, most_bytes: int) -> None:
        self.most_bytes = most_bytes
        self._values: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self.bytes = 0  # of all values together
        self._parts: State = ()
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[Cache], tuple[int]]:
        return Cache, (self.most_bytes,)

    def __len__(self) -> int:
        return len(self._values)

    def value(self, key: Hashable, make: Callable[[], Value], parts: Parts = ()) -> Value:
        """Return the value of a key; ``make`` it from the parts if it is missing."""
        value = self.get(key, parts)
        if value is None:
            since = state_of(parts)
            value = make()
            self.keep(key, value, parts, since)
        return value

    def get(self, key: Hashable, parts: Parts = ()) -> Any:
        """Return the value of a key, or None."""
        with self._lock:
            self._check(parts)
            if key not in self._values:
                return None
            self._values.move_to_end(key)
            return self._values[key][0]

    def keep(self, key: Hashable, value: Any, parts: Parts = (), since: State = ()) -> None:
        """Store a value that was made from the parts, unless it is larger than the whole cache, or a thread has changed
        a part ``since`` it was begun (``state_of``)."""
        n_bytes = ENTRY_BYTES + size_of(value)
        with self._lock:
            self._check(parts)
            if not _same(since, self._parts):
                return
            self.bytes -= self._values.pop(key, (None, 0))[1]
            if n_bytes > self.most_bytes:
                return
            self._values[key] = value, n_bytes
            self.bytes += n_bytes
            while self.bytes > self.most_bytes:
                self.bytes -= self._values.popitem(last=False)[1][1]

    def clear(self) -> None:
        """Remove all values."""
        with self._lock:
            self._empty()

    def _empty(self) -> None:
        self._values.clear()
        self.bytes = 0

    def _check(self, parts: Parts) -> None:
        state = state_of(parts)
        if not _same(state, self._parts):
            self._empty()
            self._parts = state


def size_of(value: Any) -> int:
    """Return the bytes of a value: its ``nbytes``, or those of the items of a list or tuple, or of its attributes."""
    if isinstance(value, (list, tuple)):
        return sum(map(size_of, value))
    if is_dataclass(value) and not hasattr(value, "nbytes"):
        return sum(size_of(getattr(value, attribute.name)) for attribute in fields(value))
    return len(value) if isinstance(value, bytes) else getattr(value, "nbytes", 0)


def state_of(parts: Parts) -> State:
    """Return each part with how often it was written to; inference tensors do not count that."""
    return tuple(
        (item, item._version if isinstance(item, Tensor) and not item.is_inference() else 0) for item in parts
    )


def _same(one: Sequence[tuple[object, int]], other: Sequence[tuple[object, int]]) -> bool:
    return len(one) == len(other) and all(
        a is b and before == after for (a, before), (b, after) in zip(one, other, strict=True)
    )
