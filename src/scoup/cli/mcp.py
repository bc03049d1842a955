"""scoup mcp: fields for language models, by the Model Context Protocol."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from scoup.base import InputError
from scoup.cli.console import Console
from scoup.cli.options import DeviceCommon, Model, arg, check_number
from scoup.cli.stop import end_soon, exit_code

if TYPE_CHECKING:
    from scoup.query import LanguageField


@dataclass(frozen=True, kw_only=True)
class ServeAgents:
    """Serve fields to a language model over standard input and output (Model Context Protocol): list and find things,
    relations, distances, views with marks, and export selections into one folder. A client starts this program, or
    several connect to it with --http; see docs/agents.md."""

    fields: Annotated[tyro.conf.Positional[tuple[Path, ...]], arg(metavar="FIELD [FIELD ...]")]
    """.scoup files; each is a scene, named as its file."""
    text: Model = None
    """Text encoder: a word table, a CLIP model, or open_clip:ARCH/PRETRAINED. Default: each field's."""
    words: Path | None = None
    """File of words, one per line, that may be names of things. Default: all names of a word table, else everyday
    words and names that a model gave."""
    out: Path | None = None
    """Folder into which selections may be exported; it is made, and nothing in it is overwritten. Default: exports are
    refused."""
    archive: Path | None = None
    """Archive in which things are found too, written by scoup archive."""
    http: Annotated[int | None, arg(metavar="PORT")] = None
    """Serve several clients of this machine over HTTP, at this port (0: any). Address and token are printed."""
    common: DeviceCommon = DeviceCommon()

    def run(self, console: Console) -> int:
        from scoup.io import read_words
        from scoup.view import SceneTools, serve

        self._check_options()
        words = read_words(self.words)
        fields = self._open_fields(words)
        more = []
        if self.archive is not None:
            from scoup.archive import Archive, archive_tool

            archive = Archive(self.archive, self.text)
            archive.text_encoder()  # as the fields'
            more = [archive_tool(archive)]
        tools = SceneTools(fields, self.out, words)
        try:
            stopped = serve(tools, more, self.http, partial(_announce, console, fields), end_soon)
        except KeyboardInterrupt as stop:
            return exit_code(stop)
        return 128 + stopped if stopped else 0

    def _check_options(self) -> None:
        check_number("--http", self.http, 0, 65535)
        if self.http is not None and self.common.quiet and not self.common.as_json:
            raise InputError("--quiet hides the token, without which no client of --http is served; omit it")
        names = [path.stem for path in self.fields]
        if not names or len(set(names)) < len(names):
            raise InputError(f"expected .scoup files with different names, got {', '.join(names) or 'none'}")
        if self.out is not None and self.out.exists() and not self.out.is_dir():
            raise InputError(f"{self.out}: is a file; name a folder for exports with --out")

    def _open_fields(self, words: tuple[str, ...]) -> dict[str, LanguageField]:
        """Open the fields by name; what is missing is said now, not to the model."""
        from scoup.query import Expression, LanguageField

        fields = {}
        for path in self.fields:
            field = LanguageField.load(path, words=self.text).to(self.common.device)
            len(field.gaussians)
            field.encoder.names  # noqa: B018 - opened now
            if words:
                field.question([Expression(word) for word in words])
            fields[path.stem] = field
        return fields


def _announce(console: Console, fields: Iterable[str], address: str, token: str) -> None:
    if not address:
        return console.warn(f"serving {', '.join(fields)} over standard input and output")
    console.say(f"{address}\nheader of each request: Authorization: Bearer {token}\npress Ctrl-C to stop")
    return console.result({"address": address, "token": token})
