"""The files of an OSS-Fuzz project: what they name is there, and the target of the readers takes its own seeds."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "tools" / "oss_fuzz"


def test_the_files_of_the_project() -> None:
    project = yaml.safe_load((FOLDER / "project.yaml").read_text())
    assert project["language"] == "python"
    assert project["fuzzing_engines"] == ["libfuzzer"]
    script = (FOLDER / "build.sh").read_text()
    assert subprocess.run(["bash", "-n", str(FOLDER / "build.sh")]).returncode == 0
    for name in re.findall(r"tools/\S+\.py", script):
        assert (ROOT / name).is_file(), name
    for option in re.findall(r"-D(\w+)=", script):
        assert option in (ROOT / "native" / "CMakeLists.txt").read_text()


TARGET = str(FOLDER / "fuzz_readers.py")


@pytest.fixture(scope="module")
def seeds(preloaded_python: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("seeds")
    assert subprocess.run([preloaded_python, TARGET, "--seeds", str(folder)]).returncode == 0
    return folder


def test_seeds_are_of_every_reader_and_container(seeds: Path) -> None:
    contents = [seed.read_bytes() for seed in seeds.iterdir()]
    assert len({content[0] for content in contents}) > 20
    assert {content[1] for content in contents} == {0, 1, 2}


def test_the_target_reads_its_seeds_and_reaches_code(seeds: Path) -> None:
    pytest.importorskip("atheris", reason="needs atheris")
    command = [sys.executable, TARGET, "-runs=200", str(seeds)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert max(int(number) for number in re.findall(r"cov: (\d+)", done.stderr)) > 1000
