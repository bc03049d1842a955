"""The last steps of a verb: finished files get their names, and what was kept for an interruption goes.

They are written down before the first of them, so that they are all taken, or none, whatever ends the process.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scoup.base.atomic import remove, replace
from scoup.base.errors import WriteError
from scoup.base.holding import HEX, LONGEST_STEM


@dataclass(frozen=True)
class LastSteps:
    """Files beside one output: which are moved to which names, in this order, and which are then removed.

    Attributes:
        output: the file, or field, that was made.
        moves: (from, to), paths relative to the folder of the output.
        removed: paths relative to it.
    """

    output: Path
    moves: tuple[tuple[str, str], ...]
    removed: tuple[str, ...]

    @classmethod
    def of(cls, output: Path, moves: Mapping[Path, Path], removed: Iterable[Path]) -> LastSteps:
        """The steps for files in the folder of the output whose names begin with its name, or of its name in one of its
        hidden folders.

        Raises:
            ValueError: there are others.
        """
        home = output.parent

        def name(path: Path) -> str:
            return path.relative_to(home).as_posix()

        pairs = [(name(first), name(second)) for first, second in moves.items()]
        return cls.of_record(output, {"moves": pairs, "removed": [name(path) for path in removed]})

    @classmethod
    def of_record(cls, output: Path, record: Any) -> LastSteps:
        """The steps that ``record`` wrote.

        Raises:
            ValueError, TypeError, KeyError: it is no such record, or names files that do not belong to the output.
        """
        moves = tuple((str(first), str(second)) for first, second in record["moves"])
        removed = tuple(str(name) for name in record["removed"])
        own = re.escape(output.name) + r"(\.\w+)*"
        hidden = rf"\.{re.escape(output.stem[:LONGEST_STEM])}\.{HEX}{re.escape(output.suffix)}/{re.escape(output.name)}"
        before = [*(first for first, _ in moves), *removed]
        after = [second for _, second in moves]
        if not all(re.fullmatch(rf"{own}|{hidden}", name) for name in before):
            raise ValueError("files that do not belong to the output")
        if not all(re.fullmatch(own, name) for name in after):
            raise ValueError("names that do not belong to the output")
        return cls(output, moves, removed)

    def record(self) -> dict[str, Any]:
        """As JSON values."""
        return {"moves": [list(pair) for pair in self.moves], "removed": list(self.removed)}

    @property
    def is_left(self) -> bool:
        """Whether a file is still to be moved."""
        return any((self.output.parent / first).exists() for first, _ in self.moves)

    @property
    def is_begun(self) -> bool:
        """Whether a file was moved."""
        return not all((self.output.parent / first).exists() for first, _ in self.moves)

    def take(self) -> list[str]:
        """Take the steps that are still to be taken; returns the names of the files moved.

        Raises:
            WriteError: the system refuses to move a file.
        """
        home, moved = self.output.parent, []
        for first, second in self.moves:
            try:
                replace(home / first, home / second)
            except FileNotFoundError:  # moved already
                continue
            except OSError as error:
                raise WriteError.of(home / second, error) from error
            moved.append(second)
        for name in self.removed:
            remove(home / name)
        return moved
