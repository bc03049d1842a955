"""The notebooks run unchanged, and are kept without what they print."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest

from cli_support import RUN
from scoup.base.errors import ScoupError
from scoup.view.page import page_files

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))
SECONDS = 600  # of a cell, on however busy a machine


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_kept_without_outputs(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    notebook = json.loads(text)
    assert text == json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
    cells = [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]
    assert len(cells) > 5
    assert all(
        cell["outputs"] == [] and cell["execution_count"] is None and not cell["metadata"] for cell in cells
    )
    assert set(notebook["metadata"]) == {"kernelspec", "language_info"}
    assert set(notebook["metadata"]["language_info"]) == {"name"}


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`scoup` and `python` as those of an environment that is active."""
    folder = tmp_path / "bin"
    folder.mkdir()
    program = folder / "scoup"
    program.write_text(f"#!{sys.executable}\n{RUN}\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", os.pathsep.join([str(folder), os.environ["PATH"]]))
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="the command of the test is a script of Unix")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_runs(path: Path, tmp_path: Path, command: None) -> None:
    try:
        page_files()
    except ScoupError as error:
        pytest.skip(str(error))
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("ipykernel")
    notebook = nbformat.read(path, as_version=4)
    client = nbclient.NotebookClient(
        notebook, timeout=SECONDS, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute()
    shown = {cell["id"]: cell["outputs"] for cell in notebook.cells if cell["cell_type"] == "code"}
    kinds = {
        name: {kind for output in outputs for kind in output.get("data", {})}
        for name, outputs in shown.items()
    }
    for name in ("load", "build", "ask", "world", "view", "select"):
        assert "text/html" in kinds[name], name
    assert "image/png" in kinds["sheet"]
    assert shown["absent"][0]["data"]["text/plain"] == "False"
    said = [output for outputs in shown.values() for output in outputs if output.get("name") == "stderr"]
    assert not [output["text"] for output in said]
    page = (tmp_path / "table.html").stat().st_size
    assert len(shown["view"][-1]["data"]["text/html"]) > page
    for name in ("table.scoup", "teapot.scoup", "teapot.ply"):
        assert (tmp_path / name).is_file()
