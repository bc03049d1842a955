"""Errors and warnings a user may meet. Each message names what is wrong and what to do about it."""

from __future__ import annotations

import copyreg
import difflib
import errno
import functools
import stat
import warnings
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

Entry = TypeVar("Entry")

NO_SPACE = frozenset({errno.ENOSPC, errno.EFBIG, getattr(errno, "EDQUOT", errno.ENOSPC)})
"""Errors of the system for a write without space: the disk, the quota or the largest file size is full."""
_REMEDIES = {
    **dict.fromkeys(NO_SPACE, "free some space, or choose another place"),
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), "raise the limit of open files (ulimit -n)"),
    errno.ENAMETOOLONG: "choose a shorter name",
    errno.EIO: "check its disk or network drive, and retry",
    getattr(errno, "ESTALE", errno.EIO): "check its disk or network drive, and retry",
}
"""What the user can do about an error of the system."""


class ScoupError(Exception):
    """Base of every error that a user can cause and fix. The command line prints it as one line.

    Example:
        >>> try:
        ...     scoup.load_gaussians("nothing.ply")
        ... except scoup.ScoupError as error:
        ...     print(error)
        nothing.ply: there is no such file or folder (a trained splat was expected); check the path
    """

    def __reduce__(self) -> tuple[object, ...]:
        # By its state: most classes make their message of other arguments than their ``args``.
        new = copyreg.__newobj__  # pyright: ignore[reportAttributeAccessIssue]
        return new, (type(self),), {"args": self.args, **vars(self)}


class InputError(ScoupError, ValueError):
    """A value or a file that cannot be used."""


class FileFormatError(InputError):
    """A file whose contents are not what they should be: the problem with it, and what the user can do."""

    def __init__(self, path: str | Path, problem: str, remedy: str = "") -> None:
        self.path = Path(path)
        self.problem = problem
        self.remedy = remedy
        super().__init__(f"{path}: {problem}" + (f"; {remedy}" if remedy else ""))

    @staticmethod
    def unreadable(path: str | Path, error: OSError) -> FileFormatError:
        """Return the error of a file that was found, and that the system then refuses to read."""
        if isinstance(error, FileNotFoundError):
            return FileFormatError(path, "disappeared while being read", "restore it and retry")
        remedy = _REMEDIES.get(error.errno or 0, "check its permissions")
        return FileFormatError(path, f"cannot be read ({error.strerror or error})", remedy)


class FieldVersionError(FileFormatError):
    """A language field, or another file of ours, in a version of its format that this software does not know yet; it
    reads up to ``newest``."""

    def __init__(self, path: str | Path, version: int, newest: int) -> None:
        self.version = version
        self.newest = newest
        problem = f"was written by a newer SCOUP (format version {version}, this one reads up to {newest})"
        super().__init__(path, problem, "update it: pip install -U scoup")


def check_format_version(path: str | Path, version: object, newest: int) -> None:
    """Refuse a version of a format, as a file names it, that is not one from 1 to the ``newest`` that this software
    reads."""
    if not isinstance(version, int) or isinstance(version, bool) or version < 1:
        raise FileFormatError(path, f"has an invalid format version ({version!r})", "make it again")
    if version > newest:
        raise FieldVersionError(path, version, newest)


@contextmanager
def invalid_contents(path: Path, problem: str, remedy: str) -> Iterator[None]:
    """Turn failures to interpret a file into a FileFormatError that names it, with the problem and its reason."""
    try:
        yield
    except (FileFormatError, WriteError):
        raise
    except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(path, f"{problem} ({reason})", remedy) from error


class MissingFileError(FileFormatError, FileNotFoundError):
    """A file or folder that is not there."""

    @classmethod
    def of(
        cls, path: str | Path, what: str, remedy: str = "check the path", kind: str = "file"
    ) -> MissingFileError:
        """Return the error of a path at which ``what`` was expected, a "file", "folder" or "file or folder", and where
        nothing is, or something else."""
        names = {stat.S_IFDIR: "folder", stat.S_IFREG: "file", stat.S_IFIFO: "named pipe (FIFO)",
                 stat.S_IFSOCK: "socket", stat.S_IFCHR: "device", stat.S_IFBLK: "device"}  # fmt: skip
        with suppress(OSError, ValueError):
            if name := names.get(stat.S_IFMT(Path(path).stat().st_mode)):
                return cls(path, f"is a {name}, not {what}", remedy)
        return cls(path, f"there is no such {kind} ({what} was expected)", remedy)


class OutputExistsError(ScoupError, FileExistsError):
    """An output is already there and overwriting was not allowed."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        super().__init__(f"{path}: already exists; pass `overwrite=True` to replace it")


class WriteError(InputError):
    """An output that the system refuses to write, such as on a full disk; the reason is the system's."""

    def __init__(self, path: str | Path, reason: str, remedy: str = "") -> None:
        self.path = Path(path)
        self.reason = reason
        self.remedy = remedy
        super().__init__(f"{path}: cannot be written ({reason})" + (f"; {remedy}" if remedy else ""))

    @classmethod
    def of(cls, path: str | Path, error: OSError) -> WriteError:
        """Return the error of an output for one of the system."""
        return cls(path, error.strerror or str(error), _REMEDIES.get(error.errno or 0, ""))

    def at(self, path: Path) -> WriteError:
        """Return the same error for the output that a temporary file would have become."""
        return WriteError(path, self.reason, self.remedy)


class OutputInUseError(InputError):
    """An output that another process is writing."""

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        super().__init__(
            f"{path}: is being written by another process; wait for it, or choose another output"
        )


class UnknownNameError(InputError, KeyError):
    """A word, camera or level, by its ``kind``, that is not in the set searched: the ``known`` names of a file or thing
    (``where``). The message lists the nearest names; ``remedy`` is for those who mean none of them."""

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "", remedy: str = "") -> None:
        self.kind = kind
        self.name = name
        self.where = where
        self.nearest = nearest_names(name[:QUOTED], known)
        listed = ", ".join(repr(item) for item in self.nearest) or "there are none"
        self.remedy = remedy
        self.message = f"{where and f'{where}: '}no {kind} named {quoted(name)}; nearest names: {listed}"
        self.message += remedy and f"; {remedy}"
        super().__init__(self.message)

    def __str__(self) -> str:  # KeyError would print the repr
        return self.message


def looked_up(kind: str, name: str, table: Mapping[str, Entry]) -> Entry:
    """Return the entry of a name in a table; ``kind`` is what is searched, for the error."""
    if name not in table:
        raise UnknownNameError(kind, name, table)
    return table[name]


class ScoupWarning(UserWarning):
    """Something was skipped, dropped or guessed, and the result may differ from what was expected.

    Example:
        >>> import warnings
        >>> with warnings.catch_warnings():
        ...     warnings.simplefilter("error", scoup.ScoupWarning)  # what is doubtful is an error from here on
    """


@functools.cache
def warn_once(message: str) -> None:
    """Give a ``ScoupWarning``, once in the life of the process (``warn_once.cache_clear`` forgets all of them)."""
    warnings.warn(message, ScoupWarning, stacklevel=3)


QUOTED = 80
"""Characters of a user's text that a message repeats."""


def quoted(text: str) -> str:
    """Return the text in quotes, cut after ``QUOTED`` characters."""
    if len(text) <= QUOTED:
        return repr(text)
    return f"{text[:QUOTED]!r}... ({len(text):,} characters)"


def nearest_names(name: str, known: Iterable[str]) -> list[str]:
    """Return the names of ``known`` most similar to ``name``, best first, ignoring case; at most five."""
    wanted = name.lower()
    return sorted(dict.fromkeys(known), key=lambda item: -_similarity(wanted, item.lower()))[:5]


def _similarity(wanted: str, candidate: str) -> float:
    contains = 0.5 if wanted and (wanted in candidate or candidate in wanted) else 0.0
    return difflib.SequenceMatcher(None, wanted, candidate).ratio() + contains
