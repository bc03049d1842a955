"""What is published: made from an unpacked sdist without git and npm, with the page, and looked at before."""

from __future__ import annotations

import io
import os
import shutil
import sys
import tarfile
import zipfile
from importlib.util import find_spec
from pathlib import Path
from subprocess import CompletedProcess

import pytest
from tools import check_distributions, release
from tools.build_viewer import FINGERPRINT, is_current
from tools.check_distributions import PAGE, faults, incomplete

from children import finished

ROOT = Path(__file__).resolve().parents[1]
CORE = "scoup/_native.cpython-311-x86_64-linux-gnu.so"
ABOUT = "scoup-0.1.0.dist-info"
CHANGELOG = "# Changelog\n\n## 0.2.0 (2027-01-31)\n\n### Added\n- This.\n\n## 0.1.0 (unreleased)\n\n- That.\n"


def files_of_a_wheel() -> dict[str, str]:
    page = {f"scoup/view/page/{name}": "x" for name in PAGE}
    page["scoup/view/page/licences.txt"] = "The page.\n\nthree 1 (MIT)\n\n@sparkjsdev/spark 2 (MIT)\n"
    described = "Name: scoup\n\n[a](https://a.example/docs/a.md) [b](#b)\n"
    about = {f"{ABOUT}/licenses/LICENSE": "x", f"{ABOUT}/METADATA": described}
    code = {"scoup/__init__.py": "", "scoup/models/everyday_words.txt": "tree\n", "scoup_lab/__init__.py": ""}
    code["scoup_lab/synthetic/art/table.npz"] = "x"
    return {**code, CORE: "x", **about, **page}


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({"scoup/view/page/viewer.js": ""}, ["it has no viewer.js"]),
        ({"scoup/models/everyday_words.txt": None}, ["it has no everyday_words.txt"]),
        ({"scoup_lab/synthetic/art/table.npz": None}, ["it has no table.npz"]),
        ({"scoup_lab/synthetic/art/chair.npz": "x"}, ["scoup_lab/synthetic/art/chair.npz does not belong into it"]),
        ({"scoup/view/page/licences.txt": "\nthree 1"}, ["licences.txt does not name @sparkjsdev/spark"]),
        ({f"{ABOUT}/licenses/LICENSE": None}, ["it has no LICENSE"]),
        ({f"{ABOUT}/METADATA": "[a](docs/a.md)"}, [f"{ABOUT}/METADATA links to docs/a.md"]),
        ({CORE: None}, ["it has 0 compiled cores instead of 1"]),
        ({"scoup/__pycache__/a.pyc": "x"}, ["scoup/__pycache__/a.pyc does not belong into it"]),
        ({"tests/test_a.py": "x"}, ["tests/test_a.py does not belong into it",
                                    f"it installs scoup, {ABOUT}, scoup_lab, tests"]),
        ({CORE: None, "scoup/_native.abi3.so": "x"},
         ["the name of its core and its tag do not agree about the stable interface"]),
    ],
)  # fmt: skip
def test_faults_of_a_wheel(tmp_path: Path, changes: dict[str, str | None], expected: list[str]) -> None:
    path = tmp_path / "scoup-0.1.0-cp311-cp311-manylinux_2_28_x86_64.whl"
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in {**files_of_a_wheel(), **changes}.items():
            if text is not None:
                archive.writestr(name, text)
    assert list(faults(path)) == expected


def test_a_release_is_complete_or_not() -> None:
    systems = [f"manylinux_2_28_{machine}" for machine in ("x86_64", "aarch64")]
    systems += ["macosx_11_0_arm64", "macosx_11_0_x86_64", "win_amd64"]
    names = [f"scoup-1-{python}-{system}.whl" for python in check_distributions.PYTHONS for system in systems]
    names += ["scoup-1-py3-none-any.whl", "scoup-1.tar.gz"]
    assert list(incomplete(names)) == []
    for name in names:
        assert len(list(incomplete([each for each in names if each != name]))) == 1
    assert list(incomplete([*names, "scoup-1-cp312-cp312-win32.whl"])) != []


@pytest.mark.parametrize(("tag", "stated", "message"), [
    ("v0.2.1", "0.2.0", "it should be v0.2.0"),
    ("0.2.0", "0.2.0", "it should be v0.2.0"),
    ("v0.1.0", "0.1.0", "put the date there"),
    ("v0.3.0", "0.3.0", "nothing under a heading '## 0.3.0'"),
])  # fmt: skip
def test_a_release_is_refused(tag: str, stated: str, message: str) -> None:
    with pytest.raises(release.NotReady, match=message):
        release.check(tag, f'version = "{stated}"\n', CHANGELOG)


def test_a_release_and_its_notes() -> None:
    release.check("v0.2.0", 'version = "0.2.0"\n', CHANGELOG)
    assert release.section(CHANGELOG, "0.2.0") == ("(2027-01-31)", "### Added\n- This.")
    stated = release.version((ROOT / "pyproject.toml").read_text())
    assert release.section((ROOT / "CHANGELOG.md").read_text(), stated)[1]


def built(source: Path, kind: str, out: Path, **variables: str) -> CompletedProcess[str]:
    """The backend as a frontend calls it, with no program but Python on the path."""
    call = f"import build_backend; print(build_backend.build_{kind}({str(out)!r}))"
    environment = {**os.environ, "PATH": str(out), "PYTHONPATH": str(source / "tools"), **variables}
    out.mkdir(exist_ok=True)
    return finished([sys.executable, "-c", call], cwd=source, env=environment)


@pytest.mark.skipif(find_spec("scikit_build_core") is None, reason="scikit-build-core is not installed")
@pytest.mark.skipif(not is_current(), reason="the page is not built, or of other sources")
def test_an_sdist_gives_the_wheel_without_git_and_npm(tmp_path: Path) -> None:
    checkout = tmp_path / "checkout"
    left_out = (".git", ".venv", "build", "node_modules", "__pycache__", "_native*", "benchmarks", "docs")
    shutil.copytree(ROOT, checkout, ignore=shutil.ignore_patterns(*left_out))
    dist, required = tmp_path / "dist", {"SCOUP_WITHOUT_CORE": "1", "SCOUP_PAGE_REQUIRED": "1"}
    sdist = dist / built(checkout, "sdist", dist).stdout.splitlines()[-1]
    assert list(faults(sdist)) == []
    with tarfile.open(fileobj=io.BytesIO(sdist.read_bytes())) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (source,) = (tmp_path / "unpacked").iterdir()
    wheel = dist / built(source, "wheel", dist, **required).stdout.splitlines()[-1]
    assert wheel.name.endswith("-py3-none-any.whl")
    assert list(faults(wheel)) == []
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if name.endswith(FINGERPRINT)]
    shutil.copytree(ROOT / "tools", tmp_path / "bare" / "tools")  # without the sources of the page
    refused = built(tmp_path / "bare", "sdist", dist, **required)
    assert refused.returncode == 1
    assert refused.stderr.startswith(
        "the page of scoup view could not be built: the sources of the page are not at"
    )
