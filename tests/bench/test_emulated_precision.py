"""Products as tensor cores make them, and the command that tells what they change."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from benchmarks.gpu import emulated_precision
from benchmarks.gpu.interpreting import product, truncated

from scoup.base.errors import InputError

ROOT = Path(__file__).resolve().parents[2]
SMALL = ["--n-gaussians", "60", "--width", "17", "--height", "9", "--n-atoms", "16"]


def test_tf32_keeps_eleven_bits() -> None:
    values = np.array([1 + 2**-10, 1 + 2**-11, -(1 + 2**-11), 3.0, 0.0, 2.0**-120], dtype=np.float32)
    assert truncated(values).tolist() == [1 + 2**-10, 1.0, -1.0, 3.0, 0.0, 2.0**-120]


def test_products_of_each_precision() -> None:
    random = np.random.default_rng(0)
    a, b = (random.random(shape, dtype=np.float32) for shape in ((32, 16), (16, 24)))
    exact = a.astype(np.float64) @ b.astype(np.float64)
    errors = {p: np.abs(product(a, b, p) - exact).max() / 16 for p in ("IEEE", "TF32x3", "TF32")}
    assert errors["IEEE"] < 2**-22
    assert errors["TF32x3"] < 2**-20
    assert 2**-14 < errors["TF32"] < 2**-10


def test_the_command(needs_triton: None, tmp_path: Path) -> None:
    out = tmp_path / "precision.json"
    command = [sys.executable, "-m", "benchmarks.gpu.emulated_precision", *SMALL, "--out", str(out)]
    table = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    rows = {row["name"]: row for row in json.loads(out.read_text())["rows"]}
    assert list(rows) == ["fp16x3", "tf32x3", "tf32"]
    assert [line.split(" | ")[1] for line in table.splitlines()[4:]] == list(rows)
    assert rows["fp16x3"]["cosines_max"] < 1e-5 < rows["tf32"]["cosines_max"] < 1e-2
    assert rows["fp16x3"]["pixels_of_another_order"] == 0
    again = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (again.returncode, again.stdout) == (2, "")
    assert "precision.json" in again.stderr
    assert "Traceback" not in again.stderr


def test_what_cannot_be(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="at least one"):
        emulated_precision.main(emulated_precision.parse(["--n-atoms", "0"]))
    monkeypatch.setitem(sys.modules, "triton", sys)
    with pytest.raises(InputError, match="imported already"):
        emulated_precision.main(emulated_precision.parse([]))
