"""A verb of the command line in a process of its own that records what a power cut would leave.

    python -m benchmarks.power_loss_child STORE FOLDER FLUSH VERB ...

Before each change of a file below FOLDER, and at the end, STORE/states.jsonl gets a line with two records: the names
as they are, and the names that are on the disk for certain (as of the last ``os.fsync`` of each folder). Each maps a
path to ``[number of the flushed content in STORE, size]``; ``[null, size]`` where the content was not flushed.
STORE/flushes gets the seconds of each flush. With FLUSH 0 ``os.fsync`` does nothing: the control. Nothing else of the
verb is changed. An empty STORE records nothing. Linux only.
"""

from __future__ import annotations

import atexit
import json
import os
import shutil
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from benchmarks.endurance_child import Points

Names = dict[str, tuple[int, int | None]]  # name -> inode; size of a file, None for a folder
Files = dict[str, tuple[int | None, int]]  # as in states.jsonl; the path of an empty folder ends in a slash


class Disk(Points):
    """What is on the disk for certain, by inode: contents of files, and names in folders."""

    def __init__(self, store: Path, folder: Path) -> None:
        super().__init__(str(store / "notes"), str(folder), 0)
        self._store, self._root = store, folder
        self._contents: dict[int, int] = {}  # number of the copy in the store
        self._names: dict[int, Names] = {}
        self._held: list[int] = []  # descriptors, so that no inode is used twice
        for path in (folder, *folder.rglob("*")):
            self.flushed(os.open(path, os.O_RDONLY))

    def flushed(self, descriptor: int) -> None:
        """Take the file or folder of a descriptor as being on the disk."""
        with self._lock:
            self._held.append(os.dup(descriptor))
            path, inode = Path(os.readlink(f"/proc/self/fd/{descriptor}")), os.fstat(descriptor).st_ino
            if path.is_dir():
                self._names[inode] = _names(path)
            else:
                self._contents[inode] = len(self._held)
                shutil.copyfile(path, self._store / str(len(self._held)))

    def pass_by(self, note: str, before_end: Callable[[], object] = lambda: None) -> None:
        """Record the state of the disk."""
        with self._lock:
            folders = (self._root, *(path for path in self._root.rglob("*") if path.is_dir()))
            now = {path.stat().st_ino: _names(path) for path in folders}
            line = json.dumps([self._files(now), self._files(self._names)], sort_keys=True)
            with open(self._store / "states.jsonl", "a") as stream:
                stream.write(f"{line}\n")

    def _files(self, names: Mapping[int, Names]) -> Files:
        found: Files = {}

        def add(folder: int, prefix: str) -> None:
            entries = names.get(folder, {})
            if not entries:
                found[prefix] = (None, 0)
            for name, (inode, size) in entries.items():
                if size is None:
                    add(inode, f"{prefix}{name}/")
                else:
                    found[prefix + name] = (self._contents.get(inode), size)

        add(self._root.stat().st_ino, "")
        found.pop("", None)
        return found


def _names(folder: Path) -> Names:
    return {
        entry.name: (entry.inode(), None if entry.is_dir() else entry.stat().st_size)
        for entry in os.scandir(folder)
    }


def main(arguments: list[str]) -> None:
    """Record, and run the verb."""
    store, folder, flush = Path(arguments[0]), Path(arguments[1]), arguments[2] == "1"
    if arguments[0]:
        _record(store, folder, flush)
    elif not flush:
        os.fsync = lambda descriptor: None
    from scoup.cli.app import entry

    sys.argv = ["scoup", *arguments[3:]]
    entry()


def _record(store: Path, folder: Path, flush: bool) -> None:
    disk, fsync = Disk(store, folder), os.fsync

    def noted(descriptor: int) -> None:
        if flush:
            start = time.perf_counter()
            fsync(descriptor)
            with open(store / "flushes", "a") as stream:
                stream.write(f"{time.perf_counter() - start}\n")
            disk.flushed(descriptor)

    os.fsync = noted
    sys.addaudithook(disk.audit)
    atexit.register(disk.pass_by, "end")


if __name__ == "__main__":
    main(sys.argv[1:])
