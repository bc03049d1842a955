"""The rooms and floors of docs/layout.md against the imports of the code."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "scoup"
DOCUMENTS = (ROOT / "docs" / "layout.md").read_text()


def floors() -> dict[str, int]:
    """Floor of each room, from the table of the document."""
    return {
        room: int(floor) for floor, room in re.findall(r"^\| (\d) \| `(\w+)/` \|", DOCUMENTS, re.MULTILINE)
    }


def rooms_of(node: ast.AST) -> list[str]:
    """Rooms that a node of a syntax tree imports from; "" is the package itself."""
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, f"line {node.lineno}: a relative import"
        if node.module == "scoup":
            return [alias.name for alias in node.names]
        module = node.module or ""
        return [module.split(".")[1]] if module.startswith("scoup.") else []
    if isinstance(node, ast.Import):
        names = [alias.name.split(".") for alias in node.names]
        return [".".join(name[1:2]) for name in names if name[0] == "scoup"]
    # Modules that are loaded by name.
    named = re.fullmatch(r"scoup\.(\w+)(?:\.\w+)+", str(getattr(node, "value", "")))
    return [named[1]] if named and (SOURCE / named[1]).is_dir() else []


def climbs(room: str, source: str, table: dict[str, int]) -> list[str]:
    """Imports of a file that do not go to a lower floor or to its own room."""
    return [
        f"line {getattr(node, 'lineno', 0)}: {room} (floor {table[room]}) imports {other or 'scoup'}"
        for node in ast.walk(ast.parse(source))
        for other in rooms_of(node)
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
    assert not climbs(
        "raster", "from scoup.scene.cameras import Camera\nimport scoup.raster.presets", floors()
    )


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:\w+/)+\w+\.py|(?:\w+/)+)`", DOCUMENTS))))
def test_files_of_the_document_exist(path: str) -> None:
    assert (SOURCE / path).exists() or (ROOT / path).exists()


def test_verbs_only_call_the_library() -> None:
    """The body of a verb has at most 40 lines."""
    lines = {}
    for path in (SOURCE / "cli").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and node.name == "run" and "self" in ast.dump(node.args):
                lines[path.name, node.lineno] = (node.end_lineno or 0) - node.body[0].lineno + 1
    assert len(lines) > 12
    assert not {place: count for place, count in lines.items() if count > 40}
