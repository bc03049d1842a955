"""The cost of a piece of work: seconds, and the peak of memory above that at its start."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

_STATM = Path("/proc/self/statm")
_EVERY = 0.005  # seconds


@dataclass(frozen=True)
class Cost:
    """The cost of a piece of work."""

    seconds: float  # wall-clock time
    # resident memory beyond that at the start, at its highest, sampled; None where the system does not say.
    # Memory that the process had freed and kept is not counted again.
    peak_bytes: int | None


class Meter:
    """``with Meter() as meter: ...``; then ``meter.cost``."""

    def __enter__(self) -> Meter:
        self._stop = threading.Event()
        self._before = self._peak = resident_bytes()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()
        self._started = time.perf_counter()
        return self

    def __exit__(self, *_: object) -> None:
        seconds = time.perf_counter() - self._started
        self._stop.set()
        self._thread.join()
        peak = None
        if self._before is not None and self._peak is not None:
            peak = max(0, max(self._peak, resident_bytes() or 0) - self._before)
        self.cost = Cost(seconds, peak)

    def _watch(self) -> None:
        while not self._stop.wait(_EVERY):
            now = resident_bytes()
            if now is not None and self._peak is not None:
                self._peak = max(self._peak, now)


@contextmanager
def timed(seconds: dict[str, float], stage: str) -> Iterator[None]:
    """Put the wall-clock seconds of the block into a table, under the name of the stage."""
    started = time.perf_counter()
    yield
    seconds[stage] = time.perf_counter() - started


def resident_bytes() -> int | None:
    """Return the memory of this process that is in RAM; None where the system does not say."""
    try:
        return int(_STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except (OSError, ValueError, IndexError):
        return None
