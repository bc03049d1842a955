"""One process at a time writes an output that takes long to make."""

from __future__ import annotations

import os
import re
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scoup.base.atomic import check_output, flush_names, flush_to_disk, refusals_named, remove, replace
from scoup.base.errors import InputError, ScoupError, ScoupWarning, WriteError
from scoup.base.holding import HEX, LONGEST_STEM
from scoup.base.lock_files import check_free, hold_lock, write_record
from scoup.base.shares import Share
from scoup.base.staging import defer_stops

LOCK = ".lock"
FOLDER_LOCK = "scoup.lock"
READY, UNWANTED = "ready", "unwanted"  # marks of what gets its name, or goes, with an output


@dataclass(frozen=True)
class Output:
    """An output that takes long to make, while this process holds its lock.

    It is made under another name first, and may have something beside it, such as region sums, that appears with it.
    Then the latter is marked by its name, the output gets its name, and what is marked gets its own, or goes. Killed
    amid that, the process leaves the rest to the next one that locks the output, or calls ``complete``: something is
    marked only where all is complete.

    """

    path: Path
    descriptor: int  # of the lock file
    notes: dict[str, Any] = field(default_factory=dict)  # entries of the lock file, beside its holder
    _writing: threading.Lock = field(default_factory=threading.Lock)

    def note(self, **notes: Any) -> None:
        """Write entries into the lock file; those of None are removed from it."""
        with self._writing:
            self.notes.update(notes)
            known = {name: value for name, value in self.notes.items() if value is not None}
            write_record(self.path, self.descriptor, known)

    @contextmanager
    def appearing(self, beside: Path | None = None, name: Path | None = None) -> Iterator[Path]:
        """Yield a path to write to. When the block ends, the output appears with what belongs to it, or not at all.

        Args:
            beside: a finished file or folder beside the output. Its name begins with the output's, as does the next.
            name: the name that it gets then; None removes it.
        """
        temporary = _temporary(self.path)
        try:
            with refusals_named(self.path, temporary):
                yield temporary
            self._commit(temporary, beside, name)
        except BaseException:
            remove(temporary)
            raise

    def take(self, finished: Path) -> None:
        """Give a finished file or folder the name of the output."""
        self._commit(finished, None, None)

    def _commit(self, finished: Path, beside: Path | None, name: Path | None) -> None:
        mark = UNWANTED if name is None else READY
        marked = beside and (beside, _marked(self.path, name or beside, mark))
        with defer_stops():
            flush_to_disk(finished)
            if beside is not None and name is not None:
                flush_to_disk(beside)
            try:
                if marked:
                    replace(*marked)  # from here on the rest follows, whoever does it
                    flush_names(self.path.parent)
                replace(finished, self.path)
                flush_names(self.path.parent)
            except OSError as error:
                if marked:
                    with suppress(OSError):
                        os.replace(*reversed(marked))
                raise WriteError.of(self.path, error) from error
            _finish(self.path)


@contextmanager
def locked_output(path: Path, overwrite: bool = False, is_folder: bool = False) -> Iterator[Output]:
    """Keep other processes from writing a file or folder, and what goes beside it, until the block ends.

    ``PATH.lock`` says who writes; it is removed at the end, after an interruption too. The lock of a dead process is
    taken over: its commit is completed (``Output``), and its temporary files are removed. Then the path is checked once
    more, as that process may have finished it.
    """
    own = re.escape(path.stem[:LONGEST_STEM]), re.escape(path.suffix), re.escape(path.name[:LONGEST_STEM])
    unnamed = re.escape(_temporary(path).name[: -len(".temporary")][:LONGEST_STEM])
    temporary = re.compile(rf"\.({own[0]}\.{HEX}{own[1]}|{own[2]}\.{HEX}\.\w+|{unnamed}\.{HEX}\.temporary)")
    with hold_lock(path, lock_path(path), temporary) as descriptor:
        if moved := _finish(path):
            warnings.warn(
                f"{path}: completed the renames of a killed process ({', '.join(moved)})",
                ScoupWarning,
                stacklevel=3,
            )
        remove(_temporary(path))
        check_output(path, overwrite, is_folder)
        yield Output(path, descriptor)


def complete(path: Path) -> None:
    """Complete the commit of a killed process, with a ScoupWarning, and remove its lock.

    Nothing happens if the process has left nothing, is alive, or if the system refuses.
    """
    if lock_path(path).is_file() or _unfinished(path):
        with suppress(ScoupError), locked_output(path, overwrite=True, is_folder=path.is_dir()):
            pass


def _temporary(path: Path) -> Path:
    """Return where an output is made: only its holder writes there."""
    return path.with_name(f".{path.name}.temporary")


def _marked(path: Path, name: Path, mark: str) -> Path:
    """Return the name that a file has until the output has appeared."""
    if name.parent != path.parent or not re.fullmatch(_own(path), name.name):
        raise ValueError(f"{name} does not belong to the output {path}")
    return name.with_name(f".{name.name}.{mark}")


def _own(path: Path) -> str:
    return rf"{re.escape(path.name)}(\.\w+)+"


def _unfinished(path: Path) -> list[Path]:
    """Return the files that have a mark instead of their name."""
    marked = re.compile(rf"\.{_own(path)}\.({READY}|{UNWANTED})")
    with suppress(OSError):
        return sorted(item for item in path.parent.iterdir() if marked.fullmatch(item.name))
    return []


def _finish(path: Path) -> list[str]:
    """Take the remaining steps of a commit; return the names that files got."""
    names = []
    left = _unfinished(path)
    steps = [(_temporary(path), path)] if left and _temporary(path).exists() else []
    steps += [
        (item, item.with_name(item.name[1:].removesuffix(f".{READY}")))
        for item in left
        if item.suffix == f".{READY}"
    ]
    for source, final in steps:
        try:
            replace(source, final)
        except OSError as error:
            raise WriteError.of(final, error) from error
        names.append(final.name)
    for item in left:
        if item.suffix == f".{UNWANTED}":
            remove(item)
    if left:
        flush_names(path.parent)
    return names


@contextmanager
def locked_folder(path: Path, share: Share = Share()) -> Iterator[None]:  # noqa: B008 - frozen
    """Keep other processes from writing into a folder, by a file ``scoup.lock`` in it; make the folder if missing.

    A process that does one of several shares holds ``scoup.lock.I-of-N``: a process that does all the work is kept out
    while any of them runs, and they are kept out while it runs. Raises as ``locked_output``.
    """
    if path.is_file():
        raise InputError(f"{path}: is a file, not a folder; choose another output")
    temporary = re.compile(rf"\..+\.{HEX}(\.\w+)?")
    # Whoever has taken its own lock looks for others': of two that begin together, one at least is refused.
    if not share.is_everything:
        with hold_lock(path, path / f"{FOLDER_LOCK}.{share}", temporary):
            check_free(path, path / FOLDER_LOCK)
            yield
        return
    with hold_lock(path, path / FOLDER_LOCK, temporary):
        for lock in sorted(path.glob(f"{FOLDER_LOCK}.*")):
            if is_folder_lock(lock.name):
                with hold_lock(path, lock, temporary):
                    pass  # of a dead process; now it is removed
        yield


def lock_path(output: Path) -> Path:
    """Return the place of the lock file of an output."""
    return output.with_name(output.name + LOCK)


def is_folder_lock(name: str) -> bool:
    """Return whether a file of this name in a folder is a lock of ``locked_folder``."""
    return re.fullmatch(re.escape(FOLDER_LOCK) + r"(\.\d+-of-\d+)?", name) is not None
