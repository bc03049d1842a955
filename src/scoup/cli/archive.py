"""scoup archive: many scans in one folder, searched together."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from scoup.base import InputError, check_output, counted, listed, write_text
from scoup.cli.console import Console
from scoup.cli.options import Model, WritesCommon, arg, check_number

if TYPE_CHECKING:
    from scoup.archive import Archive


@dataclass(frozen=True, kw_only=True)
class ScanOptions:
    """Options that change or list the scans."""

    add: Annotated[tuple[Path, ...], arg(metavar="FIELD [FIELD ...]")] = ()
    """Add .scoup files as scans, each named as its file; a scan that is there is replaced, but keeps its columns."""
    remove: Annotated[tuple[str, ...], arg(metavar="NAME [NAME ...]")] = ()
    """Remove scans; their fields stay."""
    list_scans: Annotated[bool, arg(name="list")] = False
    """List the scans."""
    columns: Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], arg(name="set", metavar="NAME=VALUE")] = ()
    """With --add, a column of the scans for --where, such as floor=2; once per column."""


@dataclass(frozen=True, kw_only=True)
class SearchOptions:
    """Options of a search."""

    image: Path | None = None
    """Find what looks like the object in a picture, in place of TEXT. Needs the embedding model of the archive."""
    where: str | None = None
    """A condition in SQL over the columns of the Parquet files: "floor = 2 and gaussians > 100"."""
    where_seconds: float = 30
    """Time limit of --where, in seconds."""
    top: int = 20
    """Most things to return; with --at-least, most scans."""
    at_least: int | None = None
    """Only scans with so many things that answer, those with the most first. Default: every thing that answers."""
    presence: float | None = None
    """Least score of a text that is in a scan, as for scoup query. Default: 0.35."""
    text: Model = None
    """Text encoder: a word table, a CLIP model, or open_clip:ARCH/PRETRAINED. Default: that of the first field."""
    page: Path | None = None
    """Write what was found to this HTML file, with pictures. Each thing links to itself in the page of its scan that
    scoup view FIELD.scoup --export FIELD.html wrote, if there is one."""


@dataclass(frozen=True, kw_only=True)
class SearchArchive:
    """Find things in many scans at once, or add, remove and list the scans of an archive: a folder with a Parquet file
    per scan."""

    folder: Annotated[tyro.conf.Positional[Path], arg(metavar="DIR")]
    """Folder of the archive; made when the first scan is added."""
    question: tyro.conf.Positional[str | None] = None
    """What to find: a text, or a phrase such as "mug left of the laptop"."""
    scan: ScanOptions = ScanOptions()
    search: SearchOptions = SearchOptions()
    common: WritesCommon = WritesCommon()

    def run(self, console: Console) -> None:
        scan, search = self.scan, self.search
        is_search = self.question is not None or search.image is not None
        changes = bool(scan.add), bool(scan.remove), scan.list_scans
        if sum((*changes, self.question is not None, search.image is not None)) != 1:
            raise InputError(f"{self.folder}: pass one of TEXT, --image, --add, --remove and --list")
        columns = _own_columns(scan.columns)
        if columns and not scan.add:
            raise InputError("--set is for --add")
        if search.page is not None and not is_search:
            raise InputError("--page is for TEXT and --image")
        if scan.list_scans:
            return _list(self.folder, console, True)
        check_number("--where-seconds", search.where_seconds, 0.001, 86_400)
        from scoup.archive import Archive  # loads torch, which a list does not need

        archive = Archive(self.folder, search.text, search.where_seconds)
        if is_search:
            return self._search(archive, console)
        if len({path.stem for path in scan.add}) < len(scan.add):
            raise InputError(
                f"expected .scoup files with different names, got {', '.join(map(str, scan.add))}"
            )
        with console.progress() as progress:
            for number, path in enumerate(scan.add, 1):
                archive.add(path, **columns)
                progress("add", number, len(scan.add))
        for name in scan.remove:
            archive.remove(name)
        return _list(self.folder, console, False)

    def _search(self, archive: Archive, console: Console) -> None:
        search, overwrite = self.search, self.common.overwrite
        page, question = search.page, str(search.image or self.question)
        if page is not None:
            check_output(page, overwrite=overwrite)
        if search.image is None:
            things = archive.find(question, search.where, search.top, search.at_least, search.presence)
        elif search.at_least is not None or search.presence is not None:
            raise InputError("--at-least and --presence are for texts")
        else:
            things = archive.find_image(search.image, search.where, search.top)
        counts = Counter(thing.scan for thing in things)
        doubtful = [thing for thing in things if thing.certainty == "doubtful"]
        for thing in things:
            if thing.certainty != "doubtful":
                score = "" if thing.score is None else f"{thing.score:.2f} "
                certainty = "" if thing.certainty is None else f", {thing.certainty}"
                console.say(f"{score}{thing.text}{certainty}: {thing.describe()}")
        if doubtful:
            places = listed([f"{thing.scan} (thing {thing.thing})" for thing in doubtful], 5)
            more = "more " * (len(doubtful) < len(things))
            console.say(f"{len(doubtful)} {more}{'is' if len(doubtful) == 1 else 'are'} doubtful: {places}")
        total = f"{counted(len(things), 'thing')} in {counted(len(counts), 'scan')}"
        if things.n_answers != len(things) and search.at_least is None:
            total += f", the best of {things.n_answers or 'more'}"
        order = (
            ""
            if len(doubtful) == len(things) or search.image
            else "; best first, by score and by the lead over everyday words"
        )
        console.say(f"{question}: {total + order if things else 'nothing found'}")
        if page is not None:
            from scoup.archive import results_page

            write_text(page, results_page(question, things, page), overwrite)
            console.say(f"{page}: written")
        console.result(
            {"question": question, "scans": dict(counts), "things": [thing.to_dict() for thing in things]}
        )


def _own_columns(pairs: tuple[str, ...]) -> dict[str, str | int | float]:
    """Return NAME=VALUE as columns; what reads as a number is one."""
    columns: dict[str, str | int | float] = {}
    for pair in pairs:
        name, equals, text = pair.partition("=")
        if not equals or name in columns:
            raise InputError(f"--set {pair}: expected NAME=VALUE, each name once")
        columns[name] = text
        for kind in (float, int):
            try:
                columns[name] = kind(text)
            except ValueError:
                continue
    return columns


def _list(folder: Path, console: Console, in_full: bool) -> None:
    from scoup.archive import list_scans

    scans = list_scans(folder)
    for scan in scans if in_full else ():
        pairs = ((key, " ".join(str(value).split())) for key, value in scan.columns.items())
        columns = "".join(f", {key} = {value}" for key, value in pairs)
        console.say(f"{scan.name}: {counted(scan.things, 'thing')} of {scan.field_path}{columns}")
    things = counted(sum(scan.things for scan in scans), "thing")
    console.say(f"{folder}: {counted(len(scans), 'scan')}, {things}")
    records = [
        {"scan": scan.name, "things": scan.things, "field": scan.field_path, "columns": dict(scan.columns)}
        for scan in scans
    ]
    console.result({"archive": folder, "scans": records})
