"""Does an installed scoup work? Looks for the compiled core and the page, and makes, asks and exports the small scene.

    python tools/check_installed.py [--without-core]

Run by the Python that scoup was installed into; works in a folder of its own, so that nothing of a checkout is used.
With --without-core the package must be the one without the compiled core.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path

# Isolated (-I), so that neither the folder at hand nor PYTHONPATH is searched.
PYTHON = (sys.executable, "-I")
FACTS = """
import pathlib
import scoup
from scoup.base import native
from scoup.view.page import page_files

core = native.native_core()
print(pathlib.Path(scoup.__file__).parent)
print(core.__file__ if core else "none")
print(len(page_files().program), len(page_files().licences))
"""
VERB = "from scoup.cli.app import entry; entry()"
DEMO = ("--n-gaussians", "4000", "--width", "96", "--height", "72", "--views", "4")
CHECKOUT = Path(__file__).resolve().parents[1] / "src"


class Wrong(Exception):
    """The installation does not do what it should; the text says what."""


def run(folder: Path, *arguments: str) -> str:
    """Run the interpreter in a folder; return what it printed."""
    environment = {name: value for name, value in os.environ.items() if name != "SCOUP_NATIVE"}
    done = subprocess.run(
        [*PYTHON, *arguments], cwd=folder, env=environment, capture_output=True, text=True, timeout=900
    )
    if done.returncode != 0:
        raise Wrong(f"{' '.join(arguments[-12:])} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
    return done.stdout


def check(folder: Path, without_core: bool) -> str:
    """Check the installation from an empty folder; return one line that says what it is."""
    package, core, _ = run(folder, "-c", FACTS).splitlines()  # without the page it fails, and says so
    if Path(package).is_relative_to(CHECKOUT):
        raise Wrong(
            f"{package} is the checkout; install a wheel, and run this with the Python it was installed into"
        )
    if (core == "none") != without_core:
        raise Wrong(f"the compiled core is {core}")
    run(folder, "-c", VERB, "demo", "--out", "demo", *DEMO)
    field = next((folder / "demo").rglob("*.scoup"), None)
    if field is None:
        raise Wrong("scoup demo left no field")
    run(folder, "-c", VERB, "view", str(field), "--export", "page.html")
    if (folder / "page.html").stat().st_size < 1_000_000:
        raise Wrong("the exported page is not whole")
    return f"{package} works; compiled core: {Path(core).name}"


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument(
        "--without-core", action="store_true", help="the package must be without the compiled core"
    )
    options = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            print(check(Path(folder), options.without_core))
    except Wrong as wrong:
        print(wrong, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
