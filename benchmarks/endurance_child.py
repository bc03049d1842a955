"""A verb of the command line in a process of its own that notes what it does, and that can end itself by SIGKILL.

    python benchmarks/endurance_child.py LOG FOLDER POINT VERB ...

LOG gets a line for each point: each change of a file below FOLDER, each part of a file of region sums (half of it is
written), and each view that is begun. At the POINT-th of them (1 for the first, 0 for
never) the process kills itself. Nothing of the verb is changed.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

BEGUN = "begun"  # the note of a view
_CHANGES = {"os.rename", "os.remove", "os.mkdir", "os.rmdir", "os.truncate"}
_WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC


class Points:
    """A counter of points that notes each in a log.

    ``last``: the point at which the process ends; 0 for none.
    """

    def __init__(self, log: str, folder: str, last: int) -> None:
        self._log = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o666)
        self._folder = os.path.realpath(folder) + os.sep
        self._last = last
        self._count = 0
        self._lock = threading.RLock()

    def pass_by(self, note: str, before_end: Callable[[], object] = lambda: None) -> None:
        """Count a point, note it and, if it is the last, do what is given and end."""
        with self._lock:
            self._count += 1
            os.write(self._log, f"{note}\n".encode())
            if self._count == self._last:
                before_end()
                os.kill(os.getpid(), signal.SIGKILL)

    def audit(self, event: str, arguments: tuple[Any, ...]) -> None:
        """Note changes of files: an audit hook."""
        if event == "open" and isinstance(arguments[2], int) and arguments[2] & _WRITES:
            self._file("open", arguments[0])
        elif event in _CHANGES:
            self._file(event, arguments[0])

    def _file(self, what: str, path: Any) -> None:
        if isinstance(path, int):  # a file of the verb: no other is truncated by number
            self.pass_by(f"file {what}")
        elif isinstance(path, (str, os.PathLike)) and os.path.abspath(path).startswith(self._folder):
            self.pass_by(f"file {what} {os.path.basename(path)}")


def observe(points: Points) -> None:
    """Note views, and count the parts of files of region sums."""
    from scoup import raster
    from scoup.base import atomic
    from scoup.extract.felzenszwalb import Felzenszwalb
    from scoup.uplift.storage.paths import ENDING

    _note_calls(points, raster, "region_sums")
    _note_calls(points, Felzenszwalb, "segment")
    write = atomic._Output.write  # pyright: ignore[reportPrivateUsage]

    def torn(self: Any, part: bytes | memoryview) -> int:
        if self._path.suffix == ENDING:
            points.pass_by("half a part", lambda: self._stream.write(part[: len(part) // 2]))
        return write(self, part)

    atomic._Output.write = torn  # pyright: ignore[reportPrivateUsage]


def _note_calls(points: Points, owner: Any, name: str) -> None:
    """Note a view at each call of a function."""
    function = getattr(owner, name)

    def noted(*arguments: Any, **more: Any) -> Any:
        points.pass_by(BEGUN)
        return function(*arguments, **more)

    setattr(owner, name, noted)


def main(arguments: list[str]) -> None:
    """Observe, then run the verb."""
    log, folder, last = arguments[:3]
    points = Points(log, folder, int(last))
    observe(points)
    sys.addaudithook(points.audit)
    from scoup.cli.app import entry

    sys.argv = ["scoup", *arguments[3:]]
    entry()


if __name__ == "__main__":
    sys.path.remove(str(Path(__file__).resolve().parent))  # its neighbours are no modules of a verb
    main(sys.argv[1:])
