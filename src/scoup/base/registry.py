"""Tables of what can be chosen by name, which other packages extend through entry points."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Generic, TypeVar

from scoup.base.errors import UnknownNameError, warn_once


@dataclass(frozen=True, eq=False)
class Entry:
    """A row of a ``Registry``. Each table has a kind of its own, with what opens, reads or computes."""

    name: str
    """As the user writes it. "dense:MODEL", capitals behind a colon, stands for all names that begin with "dense:"."""
    help: str = field(default="", kw_only=True)
    """One line."""
    licence: str = field(default="", kw_only=True)
    """Of the weights, or of the package where there are none."""
    extra: str = field(default="", kw_only=True)
    """Of scoup, which brings the packages that it needs."""

    def answers_to(self, name: str) -> bool:
        """Return whether a user may mean this entry by a name."""
        start, colon, rest = self.name.rpartition(":")
        return name == self.name or (bool(colon) and rest.isupper() and name.startswith(start + colon))


EntryOf = TypeVar("EntryOf", bound=Entry)


class Registry(Mapping[str, EntryOf], Generic[EntryOf]):
    """Entries by name: the project's own, then those that installed packages name as entry points.

    Other packages are looked for on first use. One that cannot be loaded is left out, with a warning. ``what`` names
    one entry in messages, ``kind`` is its class.
    """

    def __init__(self, what: str, group: str, kind: type[EntryOf], built_in: Iterable[EntryOf]) -> None:
        self.what, self.group, self.kind = what, group, kind
        self._own = {entry.name: entry for entry in built_in}

    def __getitem__(self, name: str) -> EntryOf:
        if name in self._own:
            return self._own[name]
        if name not in self._all:
            raise UnknownNameError(self.what, name, self._all)
        return self._all[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._all)

    def __len__(self) -> int:
        return len(self._all)

    def find(self, name: str) -> EntryOf:
        """Return the entry that a name means; of several the most specific."""
        entries = [entry for entry in self.values() if entry.answers_to(name)]
        if not entries:
            raise UnknownNameError(self.what, name, self._all)
        return max(entries, key=lambda entry: (entry.name == name, entry.name.rfind(":")))

    @cached_property
    def _all(self) -> dict[str, EntryOf]:
        from importlib.metadata import entry_points

        entries = dict(self._own)
        for point in entry_points(group=self.group):
            try:
                entry = point.load()
                if not isinstance(entry, self.kind):
                    raise TypeError(f"it is not of the class {self.kind.__name__}")
                if entry.name in entries:
                    raise ValueError(f"the name {entry.name!r} is taken")
                entries[entry.name] = entry
            except Exception as error:  # code of other packages may raise anything
                package = point.dist.name if point.dist is not None else "unknown"
                warn_once(
                    f"the package {package!r}: {point.name!r} of its {self.group} is left out "
                    f"({type(error).__name__}: {error}); update or uninstall that package"
                )
        return entries
