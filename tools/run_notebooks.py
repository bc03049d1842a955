"""Run the notebooks, and keep what their cells show in them.

    python tools/run_notebooks.py

The page of the viewer is left out: it takes megabytes. Needs nbclient and ipykernel, and `scoup` on the PATH.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
SECONDS = 600  # of a cell, on however busy a machine
LEFT_OUT = "view"  # cell


def executed(path: Path, folder: Path) -> Any:
    """Return a notebook with the outputs of a run in a folder; the cells see the environment of this process."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    resources = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=SECONDS, kernel_name="python3", resources=resources).execute()
    return notebook


def _kept(output: dict[str, Any]) -> dict[str, Any]:
    """Return an output without the number of its cell, which says nothing."""
    return {**output, "execution_count": None} if "execution_count" in output else output


def main() -> None:
    """Run all."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        notebook = json.loads(path.read_text(encoding="utf-8"))
        with tempfile.TemporaryDirectory() as folder:
            made = {cell["id"]: cell for cell in executed(path, Path(folder)).cells}
        for cell in notebook["cells"]:
            if cell["cell_type"] == "code" and cell["id"] != LEFT_OUT:
                cell["outputs"] = [_kept(output) for output in made[cell["id"]]["outputs"]]
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
