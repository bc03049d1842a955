"""The rooms and floors of docs/layout.md against the imports of the code."""

from __future__ import annotations

import ast
import functools
import importlib
import os
import pkgutil
import re
from collections import Counter
from pathlib import Path

import pytest

import scoup

ROOT = Path(__file__).resolve().parents[1]
PRODUCT, LABORATORY = ROOT / "src" / "scoup", ROOT / "src" / "scoup_lab"
DOCUMENTS = (ROOT / "docs" / "layout.md").read_text()
DATA = ("scene", "base")
"""Of the rooms on the ground, the first uses the second."""


@functools.cache
def nodes(source: str) -> tuple[ast.AST, ...]:
    """Of the syntax tree of a file."""
    return tuple(ast.walk(ast.parse(source)))


def floors(package: str = "scoup") -> dict[str, int]:
    """Floor of each room of a package, from its table of the document."""
    table = DOCUMENTS.split(f"| floor | room of `{package}` |")[1].split("\n\n")[0]
    return {room: int(floor) for floor, room in re.findall(r"^\| (\d) \| `(\w+)/` \|", table, re.MULTILINE)}


def doors() -> dict[str, int]:
    """Most names that each room's door may offer, from the table of the document."""
    found = re.findall(r"^\| \d \| `(\w+)/` \| (\d+) \|", DOCUMENTS, re.MULTILINE)
    return {room: int(count) for room, count in found}


def modules_of(node: ast.AST) -> list[str]:
    """Modules that a node of a syntax tree imports, or names as a string."""
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, f"line {node.lineno}: a relative import"
        module = node.module or ""
        return [f"{module}.{alias.name}" for alias in node.names] if "." not in module else [module]
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    # Modules that are loaded by name.
    named = re.fullmatch(r"((scoup(?:_lab)?\.\w+)(?:\.\w+)+)(?::\w+)?", str(getattr(node, "value", "")))
    return [named[1]] if named and (ROOT / "src" / named[2].replace(".", "/")).is_dir() else []


def rooms_of(node: ast.AST, package: str) -> list[str]:
    """Rooms of a package that a node imports from; "" is the package itself."""
    split = [module.split(".") for module in modules_of(node)]
    return [".".join(parts[1:2]) for parts in split if parts[0] == package]


def climbs(room: str, source: str, table: dict[str, int], package: str = "scoup") -> list[str]:
    """Imports of a file that do not go to a lower floor of its package or to its own room."""
    return [
        f"line {getattr(node, 'lineno', 0)}: {room} (floor {table[room]}) imports {other or package}"
        for node in nodes(source)
        for other in rooms_of(node, package)
        if other != room and (room, other) != DATA and table.get(other, 99) >= table[room]
    ]


def sources(folder: Path) -> dict[str, str]:
    return {str(path.relative_to(folder)): path.read_text() for path in sorted(folder.rglob("*.py"))}


@pytest.mark.parametrize("package", [PRODUCT, LABORATORY], ids=lambda package: package.name)
def test_the_document_lists_the_rooms(package: Path) -> None:
    rooms = {folder.name for folder in package.iterdir() if folder.is_dir() and list(folder.rglob("*.py"))}
    assert set(floors(package.name)) == rooms
    started = {"__main__.py"} if package == PRODUCT else set()
    assert {path.name for path in package.glob("*.py")} == {"__init__.py", *started}


@pytest.mark.parametrize(
    ("package", "room"),
    [(package, room) for package in (PRODUCT, LABORATORY) for room in sorted(floors(package.name))],
    ids=lambda part: part.name if isinstance(part, Path) else part,
)
def test_imports_go_down(package: Path, room: str) -> None:
    table = floors(package.name)
    found = {
        path: climbs(room, source, table, package.name) for path, source in sources(package / room).items()
    }
    assert not {path: lines for path, lines in found.items() if lines}


def test_library_messages_name_no_option_of_the_command_line() -> None:
    """They name arguments, which ``cli/console.py`` translates."""
    others = {
        "base/native.py": {"--install", "--force-reinstall", "--no-deps", "--no-cache-dir"},
        "io/langsplat_checkpoint.py": {"--include_feature"},
        "models/hub.py": {"--local-dir"},
        "view/viewed_field.py": {"--text"},  # in the command that opens a page again
    }
    found = {
        (path, option)
        for path, source in sources(PRODUCT).items()
        for node in nodes(source)
        if not path.startswith("cli/") and isinstance(node, ast.Constant) and isinstance(node.value, str)
        for option in re.findall(r"(?<![\w-])--[a-z][\w-]*", node.value)
    }
    assert found == {(path, option) for path, options in others.items() for option in options}


def test_the_product_never_imports_the_laboratory() -> None:
    """But for the table of verbs, which names modules by string."""
    found = {
        (path, isinstance(node, ast.Import | ast.ImportFrom))
        for path, source in sources(PRODUCT).items()
        for node in nodes(source)
        for module in modules_of(node)
        if module.startswith("scoup_lab")
    }
    assert found == {("cli/app.py", False)}


def past_doors(room: str, source: str) -> list[str]:
    """Imports of a file that reach into a room of the product that is not its own, past its door."""
    modules = [
        (node.lineno, module)
        for node in nodes(source)
        if isinstance(node, ast.ImportFrom | ast.Import)
        for module in ([node.module or ""] if isinstance(node, ast.ImportFrom) else modules_of(node))
    ]
    return [
        f"line {line}: {module}"
        for line, module in modules
        if module.startswith("scoup.") and module.count(".") > 1 and module.split(".")[1] != room
    ]


@pytest.mark.parametrize(
    "package", [PRODUCT, LABORATORY, ROOT / "examples"], ids=lambda package: package.name
)
def test_rooms_are_entered_by_their_doors(package: Path) -> None:
    found = {
        path: past_doors(path.partition("/")[0] if package == PRODUCT else "", source)
        for path, source in sources(package).items()
    }
    assert not {path: lines for path, lines in found.items() if lines}


@functools.cache
def used_names() -> dict[str, set[str]]:
    """Room -> names that files anywhere take from its door, by import or as ``raster.project``."""
    used: dict[str, set[str]] = {room: set() for room in floors()}
    for folder in ("src", "benchmarks", "examples", "tools", "tests"):
        for source in sources(ROOT / folder).values():
            for node in nodes(source):
                if isinstance(node, ast.ImportFrom) and str(node.module).removeprefix("scoup.") in used:
                    used[str(node.module).removeprefix("scoup.")] |= {alias.name for alias in node.names}
                elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                    used.get(node.value.id, set()).add(node.attr)
    return used


@pytest.mark.parametrize("room", sorted(floors()))
def test_a_door_offers_what_others_use(room: str) -> None:
    """No more than the table says, and nothing that no other room, example or benchmark uses."""
    door = importlib.import_module(f"scoup.{room}")
    offered = set(door.__all__)
    assert all(hasattr(door, name) for name in offered)
    assert offered <= used_names()[room] | set(scoup.__all__) | {"main"}
    assert len(offered) <= doors()[room]
    assert door.__doc__


@pytest.mark.parametrize("source", [
    "from scoup.uplift.field_build import build",
    "import scoup.uplift.voting", "from scoup import uplift", "from scoup import build", "import scoup",
    "def f():\n    from scoup.models.text import TextEncoder",
    'BACKENDS = {"native": "scoup.uplift.vote_backends.native"}',
])  # fmt: skip
def test_a_climbing_import_is_found(source: str) -> None:
    assert climbs("raster", source, floors())
    assert not climbs(
        "raster", "from scoup.scene.cameras import Camera\nimport scoup.raster.presets", floors()
    )


@pytest.mark.parametrize("path", sorted(set(re.findall(r"`((?:\w+/)+\w+\.py|(?:\w+/)+)`", DOCUMENTS))))
def test_files_of_the_document_exist(path: str) -> None:
    assert any((folder / path).exists() for folder in (PRODUCT, LABORATORY, ROOT))


@pytest.mark.parametrize("path", [".ci/run", "tools/oss_fuzz/build.sh"])
def test_scripts_that_services_start_may_be_run(path: str) -> None:
    assert os.access(ROOT / path, os.X_OK)


def test_no_two_test_files_have_one_name() -> None:
    """Pytest imports them by their names alone, and refuses the second."""
    names = Counter(path.name for path in (ROOT / "tests").rglob("test_*.py"))
    assert [name for name, count in names.items() if count > 1] == []


def test_verbs_only_call_the_library() -> None:
    """The body of a verb has at most 40 lines."""
    lines = {}
    for path, source in (*sources(PRODUCT / "cli").items(), *sources(LABORATORY / "cli").items()):
        for node in nodes(source):
            if isinstance(node, ast.FunctionDef) and node.name == "run" and "self" in ast.dump(node.args):
                lines[path, node.lineno] = (node.end_lineno or 0) - node.body[0].lineno + 1
    assert len(lines) > 12
    assert not {place: count for place, count in lines.items() if count > 40}


@pytest.mark.parametrize(
    "name", [room for room in sorted(floors()) if (PRODUCT / room / "constants.py").exists()]
)
def test_constants_are_in_the_table_alone(name: str) -> None:
    """A copy would stay as it is when a constant is left out."""
    room, table = (importlib.import_module(f"scoup.{name}{part}") for part in ("", ".constants"))
    names = {name for name in vars(table) if name.isupper()}
    for found in pkgutil.iter_modules(room.__path__, f"{room.__name__}."):
        module = importlib.import_module(found.name)
        copies = [name for name in vars(module).keys() & names if vars(module)[name] is vars(table)[name]]
        assert module is table or not copies, found.name
