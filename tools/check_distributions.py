"""What is in the wheels and the sdist that are to be published?

    python tools/check_distributions.py [--complete] FOLDER

Each must hold the page of `scoup view` with the licences of what it is made of, the everyday words, the things of
`scoup demo`, the licence of scoup, and nothing that belongs to a checkout only; a wheel has the compiled core just
where its name says so; what the package says of itself links to what can be found from elsewhere, too. With --complete
the folder must hold the sdist and a wheel for every version of Python and every system that pyproject.toml names.
"""

from __future__ import annotations

import argparse
import re
import sys
import tarfile
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

PAGE = ("index.html", "viewer.js", "viewer.css", "licences.txt")
BUNDLED = ("three ", "@sparkjsdev/spark ")
"""Packages whose licences must be in the page's licences.txt."""
STRAY = re.compile(
    r"(^|/)(__pycache__|node_modules|\.git|\.venv|\.hypothesis|build|dist)/|^(tests|docs|benchmarks|examples|notebooks)/"
    r"|\.(pyc|so\.\d|scoup|o|npz|whl)$"
)
THINGS = "_lab/synthetic/art/table.npz"
"""The things of the scene of `scoup demo`, after the folder of the package."""
LINK = re.compile(r"""(?:\]\(|src(?:set)?=")(?!https?:|#)([^)"]*)[)"]""")
"""Of Markdown and HTML, relative."""
PYTHONS = ("cp310-cp310", "cp311-cp311", "cp312-abi3")
PLATFORMS = (
    r"manylinux\S*_x86_64",
    r"manylinux\S*_aarch64",
    r"macosx_\S*_arm64",
    r"macosx_\S*_x86_64",
    "win_amd64",
)


def expected() -> Iterator[str]:
    """The end of the name of every file of a complete release, as a pattern."""
    yield r"\.tar\.gz"
    yield r"-py3-none-any\.whl"
    yield from (rf"-{python}-{platform}\.whl" for python in PYTHONS for platform in PLATFORMS)


def read(path: Path) -> dict[str, bytes]:
    """Names and contents of the files of a wheel, or of an sdist below its one folder."""
    if path.suffix == ".whl":
        with zipfile.ZipFile(path) as archive:
            return {name: archive.read(name) for name in archive.namelist() if not name.endswith("/")}
    with tarfile.open(path) as archive:
        members = [member for member in archive.getmembers() if member.isfile()]
        contents = ((member, archive.extractfile(member)) for member in members)
        return {member.name.partition("/")[2]: data.read() for member, data in contents if data is not None}


def faults(path: Path) -> Iterator[str]:
    """What is wrong with a wheel or an sdist, one sentence each."""
    files = read(path)
    is_wheel = path.suffix == ".whl"
    package = "scoup" if is_wheel else "src/scoup"
    page = f"{package}/view/page"
    yield from (f"it has no {name}" for name in PAGE if not files.get(f"{page}/{name}"))
    if not files.get(f"{package}/models/everyday_words.txt"):
        yield "it has no everyday_words.txt"
    if not files.pop(f"{package}{THINGS}", None):
        yield "it has no table.npz"
    licences = files.get(f"{page}/licences.txt", b"").decode()
    yield from (
        f"licences.txt does not name {name.strip()}" for name in BUNDLED if f"\n{name}" not in licences
    )
    if not any(PurePosixPath(name).name == "LICENSE" for name in files):
        yield "it has no LICENSE"
    for name in files:
        if re.search(r"(^|\.dist-info/)(METADATA|PKG-INFO)$", name):
            yield from (f"{name} links to {link}" for link in LINK.findall(files[name].decode()))
    yield from (f"{name} does not belong into it" for name in sorted(files) if STRAY.search(name))
    cores = [name for name in files if name.startswith(f"{package}/_native.")]
    wanted = is_wheel and not path.name.endswith("-py3-none-any.whl")
    if len(cores) != wanted:
        yield f"it has {len(cores)} compiled cores instead of {int(wanted)}"
    if ("-abi3-" in path.name) != any(".abi3." in name or name.endswith("_native.pyd") for name in cores):
        yield "the name of its core and its tag do not agree about the stable interface"
    roots = {name.split("/")[0] for name in files}
    if is_wheel and {root for root in roots if not root.endswith(".dist-info")} != {"scoup", "scoup_lab"}:
        yield f"it installs {', '.join(sorted(roots))}"


def incomplete(names: list[str]) -> Iterator[str]:
    """What the files of a release lack, or have too much; one sentence each."""
    known: set[str] = set()
    for end in expected():
        found = [name for name in names if re.search(f"{end}$", name)]
        known |= set(found)
        if len(found) != 1:
            yield f"{len(found)} files end with {end}, instead of one"
    yield from (f"{name} is not expected" for name in names if name not in known)


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path, help="of the files")
    parser.add_argument("--complete", action="store_true", help="none may be missing")
    options = parser.parse_args(arguments)
    paths = sorted([*options.folder.glob("*.whl"), *options.folder.glob("*.tar.gz")])
    wrong = [f"{path.name}: {fault}" for path in paths for fault in faults(path)]
    if not paths:
        wrong.append(f"{options.folder} has neither wheels nor an sdist")
    if options.complete:
        wrong += incomplete([path.name for path in paths])
    print("\n".join(f"{path.name}: {path.stat().st_size / 1e6:.2f} MB" for path in paths))
    print("\n".join(wrong), file=sys.stderr)
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
