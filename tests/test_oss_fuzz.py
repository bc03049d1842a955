"""The files of an OSS-Fuzz project: what they name is there, and the target of the readers takes its own seeds."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

from children import finished

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "tools" / "oss_fuzz"


def test_the_files_of_the_project() -> None:
    script = (FOLDER / "build.sh").read_text()
    finished(["bash", "-n", FOLDER / "build.sh"], check=True)
    for name in re.findall(r"tools/\S+\.py", script):
        assert (ROOT / name).is_file(), name
    for option in re.findall(r"-D(\w+)=", script):
        assert option in (ROOT / "native" / "CMakeLists.txt").read_text()


TARGET = str(FOLDER / "fuzz_readers.py")


@pytest.fixture(scope="module")
def seeds(preloaded_python: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seeds")
    finished([preloaded_python, TARGET, "--seeds", folder], check=True)
    return folder


def test_seeds_are_of_every_reader_and_container(seeds: Path) -> None:
    contents = [seed.read_bytes() for seed in seeds.iterdir()]
    assert len({content[0] for content in contents}) > 20
    assert {content[1] for content in contents} == {0, 1, 2}


def test_the_target_reads_its_seeds_and_reaches_code(seeds: Path) -> None:
    pytest.importorskip("atheris", reason="needs atheris")
    done = finished([sys.executable, TARGET, "-runs=200", seeds], check=True)
    assert max(int(number) for number in re.findall(r"cov: (\d+)", done.stderr)) > 1000
