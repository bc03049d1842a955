"""The notebooks run, and are kept with what they show."""

from __future__ import annotations

import json
import os
import re
import sys
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
from tools.run_notebooks import FOLDER, LEFT_OUT, executed

from cli_support import RUN
from scoup.base import ScoupError
from scoup.view.page import page_files

NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))
MOST_BYTES = 700_000
MACHINE = re.compile(r"/(home|root|tmp|work)/")


def shown(cells: Iterable[dict[str, Any]]) -> dict[str, str]:
    """Cell -> the text it shows, without numbers, which differ between machines."""
    return {
        cell["id"]: re.sub(
            r"[\d.,]+",
            "#",
            "".join(
                "".join(part)
                for output in cell["outputs"]
                for part in (output.get("text", ""), output.get("data", {}).get("text/plain", ""))
            ),
        )
        for cell in cells
        if cell["cell_type"] == "code" and cell["id"] != LEFT_OUT
    }


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_kept_with_what_it_shows(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert text == json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    assert len(text.encode()) < MOST_BYTES
    assert not MACHINE.search(text)
    cells = {cell["id"]: cell for cell in notebook["cells"] if cell["cell_type"] == "code"}
    assert all(cell["execution_count"] is None and not cell["metadata"] for cell in cells.values())
    assert all(cells[name]["outputs"] for name in ("load", "build", "ask", "world", "sheet", "select"))
    assert cells[LEFT_OUT]["outputs"] == []
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    assert set(notebook["metadata"]["language_info"]) == {"name"}


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.skipif(sys.platform == "win32", reason="the command of the test is a script of Unix")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    try:
        page_files()
    except ScoupError as error:
        pytest.skip(str(error))
    for package in ("nbclient", "nbformat", "ipykernel"):
        pytest.importorskip(package)
    program = tmp_path / "bin" / "scoup"  # as that of an environment that is active
    program.parent.mkdir()
    program.write_text(f"#!{sys.executable}\n{RUN}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(program.parent), os.environ["PATH"]]))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    notebook = executed(path, tmp_path)
    kept = json.loads(path.read_text(encoding="utf-8"))
    assert shown(notebook.cells) == shown(kept["cells"])  # else: python tools/run_notebooks.py
    made = {cell["id"]: cell["outputs"] for cell in notebook.cells if cell["cell_type"] == "code"}
    kinds = {
        name: {kind for output in outputs for kind in output.get("data", {})}
        for name, outputs in made.items()
    }
    for name in ("load", "build", "ask", "view"):
        assert "text/html" in kinds[name], name
    assert "image/png" in kinds["sheet"]
    assert made["absent"][0]["data"]["text/plain"] == "False"
    said = [output for outputs in made.values() for output in outputs if output.get("name") == "stderr"]
    assert not [output["text"] for output in said]
    page = (tmp_path / "table.html").stat().st_size
    assert len(made["view"][-1]["data"]["text/html"]) > page
