"""Hooks of mkdocs: generated pages, and links out of docs/ that lead to the repository."""

from __future__ import annotations

import ast
import re
import sys
from pathlib import Path
from posixpath import normpath
from typing import Any

sys.path.insert(0, str(Path(__file__).parent))  # mkdocs loads this file alone

import document_verbs

ROOT = Path(__file__).resolve().parent.parent
FROM_ROOT = {"index.md": "README.md", "contributing.md": "CONTRIBUTING.md", "changelog.md": "CHANGELOG.md"}
"""Pages of the site that are files of the repository's first folder."""
PAGES = "pages.md"
"""Page of the site that has docs/index.md, whose place the README takes."""
EXAMPLES = "Examples"
"""Entry of the navigation below which the examples are."""
LINK = re.compile(r"(\]\()([^)#:\s]+)(#[^)\s]*)?(\))")


def on_config(config: Any) -> Any:
    """Put the pages of the examples into the navigation."""
    for entry in config.nav:
        if EXAMPLES in entry:
            entry[EXAMPLES] = sorted(example_pages())
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the verbs, the examples, and the files of the first folder; the README is the front page."""
    from mkdocs.structure.files import File

    files.remove(files.get_file_from_path("index.md"))
    pages = {"verbs.md": document_verbs.page(), **example_pages()}
    pages[PAGES] = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    for page, source in FROM_ROOT.items():
        pages[page] = in_docs((ROOT / source).read_text(encoding="utf-8"))
    for page, text in pages.items():
        files.append(File.generated(config, page, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Lead links to what is not in docs/ to the repository."""
    return outside(markdown, config.repo_url)


def example_pages() -> dict[str, str]:
    """Return a page per example, path -> Markdown: its docstring as text, its code as a block."""
    pages = {}
    for path in sorted((ROOT / "examples").glob("*.py")):
        source = path.read_text(encoding="utf-8")
        first = ast.parse(source).body[0]
        code = "\n".join(source.splitlines()[first.end_lineno :]).strip()
        title = path.stem.partition("_")[2].replace("_", " ").capitalize()
        text = ast.get_docstring(ast.parse(source))
        pages[f"examples/{path.stem}.md"] = f"# {title}\n\n{text}\n\n```python\n{code}\n```\n"
    return pages


def in_docs(text: str) -> str:
    """Return a text of the first folder as if it were in docs/."""

    def moved(found: re.Match[str]) -> str:
        path = found[2].removeprefix("docs/") if found[2].startswith("docs/") else f"../{found[2]}"
        return f"{found[1]}{PAGES if path == 'index.md' else path}{found[3] or ''}{found[4]}"

    return LINK.sub(moved, text).replace('"docs/images/', '"images/')


def outside(text: str, repository: str) -> str:
    """Return a page of docs/ whose links to other folders lead to generated pages or to the repository."""
    pages = {f"../{source}": page for page, source in FROM_ROOT.items()}
    pages |= {f"../{page.removesuffix('.md')}.py": page for page in example_pages()}

    def moved(found: re.Match[str]) -> str:
        path = pages.get(found[2], found[2])
        if path.startswith("../"):
            kind = "tree" if (ROOT / "docs" / path).is_dir() else "blob"
            path = f"{repository}/{kind}/main/{normpath(path.removeprefix('../'))}"
        elif path == "benchmarks" or path.startswith("benchmarks/"):  # records: not part of the site
            path = f"{repository}/{'blob' if path.endswith('.json') else 'tree'}/main/docs/{path}"
        return f"{found[1]}{path}{found[3] or ''}{found[4]}"

    return LINK.sub(moved, text)
