"""The rooms and floors of docs/layout.md against the imports of the code."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "scoup"
DOCUMENTS = (ROOT / "docs" / "layout.md").read_text()


def floors() -> dict[str, int]:
    """Floor of each room, from the table of the document."""
    return {room: int(floor) for floor, room in re.findall(r"^\| (\d) \| `(\w+)/` \|", DOCUMENTS, re.MULTILINE)}


def imported(source: str) -> Iterator[tuple[int, str]]:
    """Line and room of every import from scoup, those inside functions too; "" is the package itself."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"line {node.lineno}: a relative import"
            if node.module == "scoup":
                yield from ((node.lineno, alias.name) for alias in node.names)
            elif node.module and node.module.startswith("scoup."):
                yield node.lineno, node.module.split(".")[1]
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.split(".")[0] == "scoup":
                    yield node.lineno, ".".join(alias.name.split(".")[1:2])
        # Modules that are loaded by name.
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            if named := re.fullmatch(r"scoup\.(\w+)((?:\.\w+)+)", node.value):
                if (SOURCE / named[1]).is_dir():
                    yield node.lineno, named[1]


def climbs(room: str, source: str, table: dict[str, int]) -> list[str]:
    """Imports of a file that do not go to a lower floor or to its own room."""
    return [
        f"line {line}: {room} (floor {table[room]}) imports {other or 'scoup'}"
        for line, other in imported(source)
        if other != room and table.get(other, 99) >= table[room]
    ]


def test_the_document_lists_the_rooms() -> None:
    rooms = {folder.name for folder in SOURCE.iterdir() if folder.is_dir() and list(folder.rglob("*.py"))}
    assert set(floors()) == rooms
    loose = {path.name for path in SOURCE.glob("*.py")}
    assert loose == {"__init__.py"}


@pytest.mark.parametrize("room", sorted(floors()))
def test_imports_go_down(room: str) -> None:
    found = {
        str(path.relative_to(SOURCE)): climbs(room, path.read_text(), floors())
        for path in sorted((SOURCE / room).rglob("*.py"))
    }
    assert not {path: lines for path, lines in found.items() if lines}


@pytest.mark.parametrize(
    "source",
    [
        "from scoup.uplift.build import build",
        "import scoup.uplift.vote",
        "from scoup import uplift",
        "from scoup import build",
        "import scoup",
        "def f():\n    from scoup.models.text import TextEncoder",
        'BACKENDS = {"native": "scoup.uplift.vote_backends.native"}',
    ],
)
def test_a_climbing_import_is_found(source: str) -> None:
    assert climbs("raster", source, floors())
    assert not climbs("raster", "from scoup.scene.cameras import Camera\nimport scoup.raster.presets", floors())


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:\w+/)+\w+\.py|(?:\w+/)+)`", DOCUMENTS))))
def test_files_of_the_document_exist(path: str) -> None:
    assert (SOURCE / path).exists() or (ROOT / path).exists()
