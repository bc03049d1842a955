"""Documents, workflows and containers name what is there; `make docs` follows the links of the site."""

from __future__ import annotations

import ast
import json
import re
import shlex
import unicodedata
from pathlib import Path
from typing import Any

import pytest
import yaml
from tools import check_distributions, site_hooks

import scoup
from scoup.base import VERSION
from scoup.base.errors import FieldVersionError
from scoup.view.viewer import PORT
from test_layout import nodes, sources

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.glob("*.md")])
PYPROJECT = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
WORKFLOWS = {
    path.stem: yaml.safe_load(path.read_text()) for path in (ROOT / ".github" / "workflows").glob("*.yml")
}
# Documents.


def anchors(path: Path) -> set[str]:
    """Of the headings of a document, as GitHub and the site make them."""
    text = re.sub(r"```.*?```", "", path.read_text(), flags=re.DOTALL)
    found = set()
    for heading in re.findall(r"^#+ (.*)$", text, re.MULTILINE):
        plain = unicodedata.normalize("NFC", re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading).lower().strip())
        found.add("".join(char for char in plain if char.isalnum() or char in "-_ ").replace(" ", "-"))
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r"```.*?```|`[^`\n]*`", "", page.read_text(), flags=re.DOTALL)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"(https?|mailto):", link):
            assert re.match(r"https?://[\w.-]+\.[a-z]+(/\S*)?$|mailto:\S+@\S+$", link), link
            continue
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), link


def test_errors_of_the_questions_are_those_of_the_program() -> None:
    found = (node for source in sources(ROOT / "src").values() for node in nodes(source))
    said = "\n".join(str(node.value) for node in found if isinstance(node, ast.Constant))
    headings = re.findall(r"^### `(.*)`$", (DOCS / "faq.md").read_text(), re.MULTILINE)
    assert len(headings) > 10
    for heading in headings:
        for part in heading.split("…"):
            assert part.strip() in said, heading
    assert f"> {FieldVersionError('FILE', 2, 1)}" in (DOCS / "versions.md").read_text()


def test_public_names_pages_and_pictures_have_their_places() -> None:
    named = re.findall(r"^::: ([\w.]+)", (DOCS / "api.md").read_text(), re.MULTILINE)
    missing = set(scoup.__all__) - {"__version__"} - {name.rpartition(".")[2] for name in named}
    assert missing == {"ScoupError", "ScoupWarning"}  # with all errors, by their module
    nav = (ROOT / "mkdocs.yml").read_text().partition("\nnav:\n")[2]
    made = {"verbs.md", "pages.md", *site_hooks.FROM_ROOT} - {"index.md"}
    assert sorted(re.findall(r": ([\w/]+\.md)$", nav, re.MULTILINE)) == sorted(
        {path.name for path in DOCS.glob("*.md")} | made
    )
    table = (ROOT / "CONTRIBUTING.md").read_text().partition("### Pictures\n")[2]
    pictures = re.findall(r"`([\w-]+\.(?:jpg|svg|webp))`", table)
    assert sorted(pictures) == sorted(path.name for path in (DOCS / "images").iterdir())


def test_citation_and_bundle_are_of_this_version() -> None:
    assert str(yaml.safe_load((ROOT / "CITATION.cff").read_text())["version"]) == VERSION
    bundle = json.loads((ROOT / "tools" / "mcpb" / "manifest.json").read_text())
    assert bundle["version"] == VERSION
    assert f"scoup[mcp,models]=={VERSION}" in bundle["server"]["mcp_config"]["args"]


# Workflows, and what they publish.


def steps(name: str) -> list[dict[str, Any]]:
    return [step for content in WORKFLOWS[name]["jobs"].values() for step in content.get("steps", ())]


@pytest.mark.parametrize("name", WORKFLOWS)
def test_nothing_is_permitted_but_where_it_is_needed(name: str) -> None:
    """Actions are pinned by commit, and what an event says does not become part of a command: variables carry it."""
    assert WORKFLOWS[name]["permissions"] == {}
    for job, content in WORKFLOWS[name]["jobs"].items():
        if name != "release" and "deploy" not in job:
            assert content["permissions"] == {"contents": "read"}, job
    for step in steps(name):
        assert re.fullmatch(r"[\w-]+/[\w-]+@[0-9a-f]{40}", step.get("uses", f"a/b@{'0' * 40}")), step
        assert "${{" not in step.get("run", "")
        if step.get("uses", "").startswith("actions/checkout@"):
            assert step["with"]["persist-credentials"] is False


def test_versions_of_python_are_tested_and_have_wheels() -> None:
    served = re.findall(r'"Programming Language :: Python :: (3\.\d+)"', PYPROJECT)
    assert WORKFLOWS["tests"]["jobs"]["test"]["strategy"]["matrix"]["python"] == served
    assert f'requires-python = ">={served[0]}"' in PYPROJECT
    assert [f"3.{minor}" for minor in re.findall(r'"cp3(\d+)-\*"', PYPROJECT)] == served
    (stable,) = re.findall(r'^wheel.py-api = "(cp3\d+)"$', PYPROJECT, re.MULTILINE)
    # One wheel for each version before the stable interface, and one for all from there on.
    own = [name for name in (each.replace("3.", "cp3") for each in served) if name < stable]
    assert list(check_distributions.PYTHONS) == [*(f"{name}-{name}" for name in own), f"{stable}-abi3"]


def test_what_is_published_has_the_hashes_that_were_checked() -> None:
    for name, job in WORKFLOWS["release"]["jobs"].items():
        of_job = job.get("steps", ())
        taken = [
            place for place, step in enumerate(of_job) if str(step.get("with", {}).get("pattern")) == "dist-*"
        ]
        if taken:
            assert "sha256sum --check --strict" in of_job[taken[0] + 1].get("run", ""), name
        assert taken or not any("publish" in step.get("uses", "") for step in of_job)
    for step in [*steps("wheels"), *steps("release")]:
        for line in re.split(r"\n|&&|\|\|", step.get("run", "")):
            words = shlex.split(line, comments=True)
            assert "pip" not in words or words[0] == "uv" or "--require-hashes" in words, words


@pytest.mark.parametrize("name", ["Dockerfile", "Dockerfile.cuda"])
def test_containers_have_what_they_need(name: str) -> None:
    text = (ROOT / "docker" / name).read_text().replace("\\\n", " ")
    copies = re.findall(r"^COPY (?!--from)(.*) \S+$", text, re.MULTILINE)
    assert all((ROOT / source).exists() for sources in copies for source in sources.split())
    assert re.findall(r"^USER (.*)$", text, re.MULTILINE)[-1] not in ("root", "0", "0:0")
    assert re.findall(r"^EXPOSE (.*)$", text, re.MULTILINE) == [str(PORT)]
