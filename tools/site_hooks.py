"""What mkdocs does beside its usual work: adds generated pages, and leads links out of docs/ to the repository."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from posixpath import normpath
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # mkdocs loads this file alone

import document_verbs

ROOT = Path(__file__).resolve().parent.parent
FROM_ROOT = {"contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}
"""Pages of the site that are files of the repository's first folder."""
LINK = re.compile(r"(\]\()([^)#:\s]+)(#[^)\s]*)?(\))")


def on_files(files: Any, config: Any) -> Any:
    """The verbs, and the files of the first folder."""
    from mkdocs.structure.files import File

    pages = {"verbs.md": document_verbs.page()}
    for page, source in FROM_ROOT.items():
        pages[page] = in_docs((ROOT / source).read_text(encoding="utf-8"))
    for page, text in pages.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Links to what is not in docs/ lead to the repository."""
    return outside(markdown, config.repo_url)


def in_docs(text: str) -> str:
    """A text of the first folder as if it stood in docs/."""

    def moved(found: re.Match[str]) -> str:
        path = found[2].removeprefix("docs/") if found[2].startswith("docs/") else f"../{found[2]}"
        return f"{found[1]}{path}{found[3] or ''}{found[4]}"

    return LINK.sub(moved, text)


def outside(text: str, repository: str) -> str:
    """Links of a page of docs/ to other folders, as addresses of the repository."""
    pages = {f"../{source}": page for page, source in FROM_ROOT.items()}

    def moved(found: re.Match[str]) -> str:
        path = pages.get(found[2], found[2])
        if path.startswith("../"):
            kind = "tree" if (ROOT / "docs" / path).is_dir() else "blob"
            path = f"{repository}/{kind}/main/{normpath(path.removeprefix('../'))}"
        elif path == "benchmarks" or path.startswith("benchmarks/"):  # records: not part of the site
            path = f"{repository}/{'blob' if path.endswith('.json') else 'tree'}/main/docs/{path}"
        return f"{found[1]}{path}{found[3] or ''}{found[4]}"

    return LINK.sub(moved, text)
