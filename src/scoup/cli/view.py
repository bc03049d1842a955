"""scoup view: a field in the browser."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from scoup.base import InputError, counted
from scoup.cli.console import Console
from scoup.cli.options import AllCommon, FieldFile, arg, check_number
from scoup.cli.query_options import TextOptions
from scoup.cli.stop import Terminated

if TYPE_CHECKING:
    from scoup.view import ViewedField

_MEGABYTE = 1e6


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Contents of the page."""

    words: Path | None = None
    """File of words, one per line: the choices of a click, and all that an exported page can be asked. Default:
    everyday words, or all names of a word table."""
    most: int = 1_000_000
    """Most Gaussians that the page shows; neighbours are merged until no more are left. From 250,000 on, a live page
    shows up to as many again unmerged where the camera is near. Pictures of the server show all."""
    remote: bool = False
    """Send only rendered pictures: for scenes too large for the browser."""


@dataclass(frozen=True, kw_only=True)
class ServerOptions:
    """Address of the page."""

    host: str = "127.0.0.1"
    """Address to bind to. 0.0.0.0 admits other machines: all that know the address, which contains a token."""
    port: int | None = None
    """Port to bind to; 0 takes any. Default: 8350 or, if that is in use, any."""


@dataclass(frozen=True, kw_only=True)
class ExportOptions:
    """A page without a server."""

    export: Path | None = None
    """Write a page to this HTML file, and exit."""
    split: bool = False
    """With --export: a folder, with the data in files beside the page."""


@dataclass(frozen=True, kw_only=True)
class View:
    """Show a field in the browser: type a word, and the splat lights up.

    Prints the address of the page and serves it until Ctrl-C, to this machine only unless --host is passed. --export
    writes a page that needs no server and no network.
    """

    field: FieldFile
    """The .scoup file."""
    page: PageOptions = PageOptions()
    server: ServerOptions = ServerOptions()
    exported: Annotated[ExportOptions, arg(name="export")] = ExportOptions()
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> int:
        self._check_options()
        if self.exported.export is None:
            return self._serve(console)
        self._export(console, self.exported.export)
        return 0

    def _check_options(self) -> None:
        from scoup.view import check_needed

        export, split = self.exported.export, self.exported.split
        check_number("--port", self.server.port, 0, 65535)
        if split and export is None:
            raise InputError("--split belongs to --export; pass both or neither")
        if export is not None and not split and export.suffix.lower() not in (".html", ".htm"):
            raise InputError(f"{export}: expected a name that ends in .html; for a folder, pass --split")
        check_needed(export is None)

    def _viewed(self, console: Console) -> ViewedField:
        """Return the field with its encoder; say why, if no text can be asked."""
        from scoup.io import read_words
        from scoup.view import ViewedField

        field, page = self.opening.open(self.field, self.common.device), self.page
        viewed = ViewedField(field, read_words(page.words), page.most)
        if viewed.words_problem is not None:
            console.warn(f"no text can be asked: {viewed.words_problem}")
        else:
            viewed.vocabulary()  # a word that is not in the table is named now
        return viewed

    def _export(self, console: Console, out: Path) -> None:
        from scoup.view import export_page

        viewed = self._viewed(console)
        with console.progress() as progress:
            report = export_page(viewed, out, self.exported.split, self.common.overwrite, progress)
        sizes = ", ".join(
            f"{what} {_size(count)}"
            for what, count in (("scene", report.scene_bytes), ("words", report.words_bytes))
        )
        console.say(f"{out}: {_size(report.bytes)} ({sizes}, before base64), {counted(report.words, 'word')}")
        console.result(asdict(report))

    def _serve(self, console: Console) -> int:
        """Serve until the process is interrupted or terminated: both are the usual end."""
        from scoup.view import Viewer

        viewed, host = self._viewed(console), self.server.host
        try:
            with Viewer(viewed, host, self.server.port, self.page.remote) as viewer:
                if not viewer.is_local:
                    console.warn(
                        f"{host}: other machines can reach this page; whoever has the address can ask the field "
                        "and download its Gaussians; the connection is not encrypted"
                    )
                console.say(f"{self.field}: {viewer.address}\npress Ctrl-C to stop")
                console.result({"address": viewer.address, "field": self.field})
                viewer.wait()
        except KeyboardInterrupt as stop:
            console.say("\nclosed")
            return 143 if isinstance(stop, Terminated) else 0
        return 0


def _size(count: int) -> str:
    digits = 0 if count >= 100 * _MEGABYTE else 2 - max(0, math.floor(math.log10(max(count, 1) / _MEGABYTE)))
    return f"{count / _MEGABYTE:.{min(digits, 3)}f} MB"
