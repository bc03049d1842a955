"""A child process with a limit of memory, whose memory is sampled."""

from __future__ import annotations

import os
import subprocess
import threading
import uuid
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

_GROUPS = Path("/sys/fs/cgroup")
_EVERY = 0.05  # seconds


@dataclass(frozen=True)
class Watched:
    """A process that has ended."""

    output: str  # its standard output
    anonymous: int  # bytes of its own memory at the most (RssAnon), sampled; what the system cannot take back
    resident: int  # bytes at the most, with what it had mapped of files (VmHWM)
    limited: bool  # whether it was held to the limit, files that the system caches for it included

    def memory(self) -> dict[str, int | bool]:
        """Return what is known of its memory."""
        record = asdict(self)
        del record["output"]
        return record


def run_limited(command: Sequence[str], most_bytes: int, environment: dict[str, str]) -> Watched:
    """Run a command within a control group of so many bytes, where the system allows to make one."""
    with _group(most_bytes) as group:
        process = subprocess.Popen(
            command, stdout=subprocess.PIPE, text=True, env={**os.environ, **environment},
            preexec_fn=None if group is None else lambda: _enter(group),
        )  # fmt: skip
        peaks = {"RssAnon": 0, "VmHWM": 0}
        stop = threading.Event()

        def watch() -> None:
            while not stop.wait(_EVERY):
                for name, value in memory_of(process.pid).items():
                    peaks[name] = max(peaks[name], value)

        watcher = threading.Thread(target=watch, daemon=True)
        watcher.start()
        output = process.communicate()[0]
        stop.set()
        watcher.join()
    if process.returncode:
        raise SystemExit(f"{' '.join(command)}: ended with {process.returncode}")
    return Watched(output, peaks["RssAnon"], peaks["VmHWM"], group is not None)


def memory_of(process: int) -> dict[str, int]:
    """Return a process's own memory now (RssAnon) and its most resident memory (VmHWM), bytes; {} if unknown."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return {}
    fields = dict(line.split(":", 1) for line in lines if line.startswith(("RssAnon", "VmHWM")))
    return {name: int(value.split()[0]) * 1024 for name, value in fields.items()}


@contextmanager
def _group(most_bytes: int) -> Iterator[Path | None]:
    """Make a control group with a limit of memory and yield its folder; None where none can be made."""
    first = (_GROUPS / "memory").is_dir()
    folder = (_GROUPS / "memory" if first else _GROUPS) / f"scoup-{uuid.uuid4().hex[:8]}"
    try:
        folder.mkdir()
    except OSError:
        yield None
        return
    try:
        (folder / ("memory.limit_in_bytes" if first else "memory.max")).write_text(str(most_bytes))
        yield folder
    except OSError:
        yield None
    finally:
        folder.rmdir()


def _enter(group: Path) -> None:
    (group / "cgroup.procs").write_text(str(os.getpid()))
