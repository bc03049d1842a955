"""A cache of the values used last."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Hashable
from typing import Any


class Recent:
    """The last ``most`` values used, of ``most_bytes`` together. Threads may share it; copies start empty."""

    def __init__(self, most: int, most_bytes: int) -> None:
        self.most, self.most_bytes = most, most_bytes
        self._kept: OrderedDict[Hashable, tuple[Any, int]] = OrderedDict()
        self._bytes = 0
        self._lock = threading.Lock()

    def __reduce__(self) -> tuple[type[Recent], tuple[int, int]]:
        return Recent, (self.most, self.most_bytes)

    def __len__(self) -> int:
        return len(self._kept)

    @property
    def bytes(self) -> int:
        """Bytes of all values together."""
        return self._bytes

    def get(self, key: Hashable) -> Any:
        """Return the value of a key; None if it is not kept."""
        with self._lock:
            if key not in self._kept:
                return None
            self._kept.move_to_end(key)
            return self._kept[key][0]

    def keep(self, key: Hashable, value: Any, n_bytes: int) -> None:
        """Keep a value of this size, unless it is larger than all may be together."""
        with self._lock:
            self._bytes -= self._kept.pop(key, (None, 0))[1]
            if n_bytes > self.most_bytes:
                return
            self._kept[key] = value, n_bytes
            self._bytes += n_bytes
            while self._bytes > self.most_bytes or len(self._kept) > self.most:
                self._bytes -= self._kept.popitem(last=False)[1][1]

    def clear(self) -> None:
        """Keep nothing."""
        with self._lock:
            self._kept.clear()
            self._bytes = 0
