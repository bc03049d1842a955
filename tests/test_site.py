"""The documents lead somewhere, and say what the program says: links, verbs, errors, pictures, names."""

from __future__ import annotations

import ast
import re
import unicodedata
from pathlib import Path
from types import SimpleNamespace

import pytest
import yaml
from tools import document_verbs, site_hooks

import scoup

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.glob("*.md")])
LINK = re.compile(r"\]\(([^)\s]+)\)")
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)


def anchors(path: Path) -> set[str]:
    """Of the headings of a document, as GitHub and the site make them."""
    headings = re.findall(
        r"^#+ (.*)$", re.sub(r"```.*?```", "", path.read_text(), flags=re.DOTALL), re.MULTILINE
    )
    plain = [
        re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).replace("`", "").strip() for heading in headings
    ]
    kept = [
        "".join(
            char for char in unicodedata.normalize("NFC", text.lower()) if char.isalnum() or char in "-_ "
        )
        for text in plain
    ]
    return {text.replace(" ", "-") for text in kept}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    for link in LINK.findall(CODE.sub("", page.read_text())):
        if re.match(r"(https?|mailto):", link):
            assert re.match(r"https?://[\w.-]+\.[a-z]+(/\S*)?$|mailto:\S+@\S+$", link), link
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), link


def test_every_verb_is_on_the_page_of_verbs() -> None:
    page = document_verbs.page()
    for verb in document_verbs.verbs(document_verbs.SCOUP):
        section = document_verbs.section(verb)
        assert section in page
        assert f"usage: scoup {' '.join(verb)} " in section
        assert "--json" in section


def said_in(folder: Path) -> str:
    """All texts in the code below a folder."""
    texts = []
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                texts.append(node.value)
    return "\n".join(texts)


def test_errors_of_the_questions_are_those_of_the_program() -> None:
    said = said_in(ROOT / "src")
    headings = re.findall(r"^### `(.*)`$", (DOCS / "faq.md").read_text(), re.MULTILINE)
    assert len(headings) > 10
    for heading in headings:
        for part in heading.split("…"):
            assert part.strip() in said, heading


def test_every_public_name_is_in_the_reference() -> None:
    named = re.findall(r"^::: ([\w.]+)", (DOCS / "api.md").read_text(), re.MULTILINE)
    missing = set(scoup.__all__) - {"__version__"} - {name.rpartition(".")[2] for name in named}
    assert missing == {"ScoupError", "ScoupWarning"}  # with all errors, by their module
    assert "scoup.base.errors" in named


def test_every_page_is_in_the_navigation() -> None:
    text = re.sub(r"!!python\S* \{.*\}", "null", (ROOT / "mkdocs.yml").read_text())
    found: list[str] = re.findall(r"'([\w/]+\.md)'", str(yaml.safe_load(text)["nav"]))
    made = {"verbs.md", *site_hooks.FROM_ROOT}
    assert sorted(found) == sorted({path.name for path in DOCS.glob("*.md")} | made)


def test_every_example_is_a_page() -> None:
    config = SimpleNamespace(nav=[{"Home": "index.md"}, {"Examples": []}])
    site_hooks.on_config(config)
    scripts = sorted((ROOT / "examples").glob("*.py"))
    assert config.nav == [
        {"Home": "index.md"},
        {"Examples": [f"examples/{path.stem}.md" for path in scripts]},
    ]
    assert "- Examples: []" in (ROOT / "mkdocs.yml").read_text()
    pages = site_hooks.example_pages()
    for path in scripts:
        head, block, code = pages[f"examples/{path.stem}.md"].partition("```python\n")
        title, text = head.split("\n\n", 1)
        assert re.fullmatch("# [A-Z][a-z ]+", title)
        # Nothing of the file is lost: docstring, then code.
        written = path.read_text().replace('"""', "", 2).split()
        assert [*text.split(), *code.removesuffix("```\n").split()] == written
        assert block


def test_links_out_of_the_documents_lead_to_the_repository() -> None:
    text = "[a](../examples) [b](../CONTRIBUTING.md#x) [c](benchmarks/query.json) [d](method.md#y) [e](https://x.org)"
    assert site_hooks.outside(text, "R") == (
        "[a](R/tree/main/examples) [b](contributing.md#x) [c](R/blob/main/docs/benchmarks/query.json) "
        "[d](method.md#y) [e](https://x.org)"
    )
    assert site_hooks.outside("[a](../examples/00_pipeline.py)", "R") == "[a](examples/00_pipeline.md)"
    assert site_hooks.in_docs("[a](docs/gpu.md#z) [b](LICENSE)") == "[a](gpu.md#z) [b](../LICENSE)"


def test_every_picture_says_where_it_is_from() -> None:
    table = (ROOT / "CONTRIBUTING.md").read_text().partition("### Pictures\n")[2]
    said = re.findall(r"`([\w-]+\.(?:jpg|png))`", table)
    assert sorted(said) == sorted(path.name for path in (DOCS / "images").iterdir())
