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

import pytest
from tools import check_distributions, release
from tools.build_viewer import FINGERPRINT, is_current
from tools.check_distributions import PAGE, faults, incomplete

from children import finished

ROOT = Path(__file__).resolve().parents[1]
CORE = "scoup/_native.cpython-311-x86_64-linux-gnu.so"
WHEEL = "scoup-0.1.0-cp311-cp311-manylinux_2_28_x86_64.whl"
CHANGELOG = "# Changelog\n\n## 0.2.0 (2027-01-31)\n\n### Added\n- This.\n\n## 0.1.0 (unreleased)\n\n- That.\n"


def files_of_a_wheel() -> dict[str, str]:
    page = {f"scoup/view/page/{name}": "x" for name in PAGE}
    page["scoup/view/page/licences.txt"] = "The page.\n\nthree 1 (MIT)\n\n@sparkjsdev/spark 2 (MIT)\n"
    described = "Name: scoup\n\n[a](https://a.example/docs/a.md) [b](#b)\n"
    about = {"scoup-0.1.0.dist-info/licenses/LICENSE": "x", "scoup-0.1.0.dist-info/METADATA": described}
    code = {"scoup/__init__.py": "", "scoup/models/everyday_words.txt": "tree\n", "scoup_lab/__init__.py": ""}
    code["scoup_lab/synthetic/art/table.npz"] = "x"
    return {**code, CORE: "x", **about, **page}


def write_wheel(folder: Path, files: dict[str, str], name: str = WHEEL) -> Path:
    path = folder / name
    with zipfile.ZipFile(path, "w") as archive:
        for each, content in files.items():
            archive.writestr(each, content)
    return path


def test_a_whole_wheel_has_no_faults(tmp_path: Path) -> None:
    assert list(faults(write_wheel(tmp_path, files_of_a_wheel()))) == []


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scoup/view/page/viewer.js": None}, "it has no viewer.js"),
        ({"scoup/view/page/viewer.js": ""}, "it has no viewer.js"),
        ({"scoup/models/everyday_words.txt": None}, "it has no everyday_words.txt"),
        ({"scoup_lab/synthetic/art/table.npz": None}, "it has no table.npz"),
        ({"scoup_lab/synthetic/art/chair.npz": "x"}, "chair.npz does not belong into it"),
        ({"scoup/view/page/licences.txt": "\nthree 1"}, "licences.txt does not name @sparkjsdev/spark"),
        ({"scoup-0.1.0.dist-info/licenses/LICENSE": None}, "it has no LICENSE"),
        ({"scoup-0.1.0.dist-info/METADATA": "[a](docs/a.md)"}, "dist-info/METADATA links to docs/a.md"),
        ({CORE: None}, "it has 0 compiled cores instead of 1"),
        ({"scoup/__pycache__/a.pyc": "x"}, "scoup/__pycache__/a.pyc does not belong into it"),
        ({"tests/test_a.py": "x"}, "tests/test_a.py does not belong into it"),
        ({CORE: None, "scoup/_native.abi3.so": "x"}, "its tag do not agree"),
    ],
)
def test_faults_are_found(tmp_path: Path, changes: dict[str, str | None], message: str) -> None:
    files = {**files_of_a_wheel(), **changes}
    found = list(
        faults(write_wheel(tmp_path, {name: text for name, text in files.items() if text is not None}))
    )
    assert any(message in fault for fault in found), found


def test_the_wheel_without_the_core_has_none(tmp_path: Path) -> None:
    files = files_of_a_wheel()
    name = "scoup-0.1.0-py3-none-any.whl"
    assert list(faults(write_wheel(tmp_path, files, name))) == ["it has 1 compiled cores instead of 0"]
    del files[CORE]
    assert list(faults(write_wheel(tmp_path, files, name))) == []


def test_a_release_is_complete_or_not() -> None:
    systems = [
        "manylinux_2_27_x86_64.manylinux_2_28_x86_64",
        "manylinux_2_28_aarch64",
        "macosx_11_0_arm64",
        "macosx_11_0_x86_64",
        "win_amd64",
    ]
    names = [f"scoup-1-{python}-{system}.whl" for python in check_distributions.PYTHONS for system in systems]
    names += ["scoup-1-py3-none-any.whl", "scoup-1.tar.gz"]
    assert list(incomplete(names)) == []
    for name in names:
        assert len(list(incomplete([each for each in names if each != name]))) == 1
    too_many = "scoup-1-cp312-cp312-win32.whl"
    assert list(incomplete([*names, too_many])) == [f"{too_many} is not expected"]


@pytest.mark.parametrize(
    ("tag", "stated", "message"),
    [
        ("v0.2.1", "0.2.0", "it should be v0.2.0"),
        ("0.2.0", "0.2.0", "it should be v0.2.0"),
        ("v0.1.0", "0.1.0", "put the date there"),
        ("v0.3.0", "0.3.0", "nothing under a heading '## 0.3.0'"),
    ],
)
def test_a_release_is_refused(tag: str, stated: str, message: str) -> None:
    with pytest.raises(release.NotReady, match=message):
        release.check(tag, f'version = "{stated}"\n', CHANGELOG)


def test_a_release_and_its_notes() -> None:
    release.check("v0.2.0", 'version = "0.2.0"\n', CHANGELOG)
    assert release.section(CHANGELOG, "0.2.0") == ("(2027-01-31)", "### Added\n- This.")
    assert release.section(CHANGELOG, "0.1.0")[1] == "- That."


def test_the_changelog_has_notes_for_this_version() -> None:
    stated = release.version((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    assert release.section((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), stated)[1]


def build(source: Path, kind: str, out: Path, **variables: str) -> Path:
    """Calls the backend as a frontend does, with no program but Python on the path."""
    call = f"import build_backend; print(build_backend.build_{kind}({str(out)!r}))"
    environment = {**os.environ, "PATH": str(out), "PYTHONPATH": str(source / "tools"), **variables}
    out.mkdir(exist_ok=True)
    done = finished([sys.executable, "-c", call], check=True, cwd=source, env=environment)
    return out / done.stdout.splitlines()[-1]


@pytest.mark.skipif(find_spec("scikit_build_core") is None, reason="scikit-build-core is not installed")
@pytest.mark.skipif(not is_current(), reason="the page is not built, or of other sources")
def test_an_sdist_gives_the_wheel_without_git_and_npm(tmp_path: Path) -> None:
    checkout = tmp_path / "checkout"
    left_out = (".git", ".venv", "build", "node_modules", "__pycache__", "_native*", "benchmarks", "docs")
    shutil.copytree(ROOT, checkout, ignore=shutil.ignore_patterns(*left_out))
    sdist = build(checkout, "sdist", tmp_path / "dist")
    assert list(faults(sdist)) == []
    with tarfile.open(fileobj=io.BytesIO(sdist.read_bytes())) as archive:
        archive.extractall(tmp_path / "unpacked", filter="data")
    (source,) = (tmp_path / "unpacked").iterdir()
    required = {"SCOUP_WITHOUT_CORE": "1", "SCOUP_PAGE_REQUIRED": "1"}
    wheel = build(source, "wheel", tmp_path / "dist", **required)
    assert wheel.name.endswith("-py3-none-any.whl")
    assert list(faults(wheel)) == []
    with zipfile.ZipFile(wheel) as archive:
        assert not [name for name in archive.namelist() if name.endswith(FINGERPRINT)]


@pytest.mark.skipif(find_spec("scikit_build_core") is None, reason="scikit-build-core is not installed")
def test_where_the_page_is_required_its_lack_is_an_error(tmp_path: Path) -> None:
    shutil.copytree(ROOT / "tools", tmp_path / "tools")
    call = "import build_backend; build_backend.build_sdist('.')"
    environment = {**os.environ, "PYTHONPATH": str(tmp_path / "tools"), "SCOUP_PAGE_REQUIRED": "1"}
    done = finished([sys.executable, "-c", call], cwd=tmp_path, env=environment)
    assert done.returncode == 1
    assert done.stderr.startswith(
        "the page of scoup view could not be built: the sources of the page are not at"
    )
