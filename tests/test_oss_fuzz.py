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


def test_the_target_reads_its_seeds_and_reaches_code(tmp_path: Path) -> None:
    pytest.importorskip("atheris", reason="needs atheris")
    target = [sys.executable, str(FOLDER / "fuzz_readers.py")]
    assert subprocess.run([*target, "--seeds", str(tmp_path / "seeds")]).returncode == 0
    seeds = list((tmp_path / "seeds").iterdir())
    assert len({seed.read_bytes()[0] for seed in seeds}) > 20
    done = subprocess.run([*target, "-runs=200", str(tmp_path / "seeds")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert max(int(number) for number in re.findall(r"cov: (\d+)", done.stderr)) > 1000
