"""What is written for contributors: paths that exist, one address of the repository, forms and hooks that are read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml

from scoup.base.version import VERSION

ROOT = Path(__file__).resolve().parents[1]
TEXTS = (
    "CONTRIBUTING.md",
    "SECURITY.md",
    "CODE_OF_CONDUCT.md",
    "docs/versions.md",
    ".github/pull_request_template.md",
)
REPOSITORY = "https://github.com/scoup/scoup"
PATH = re.compile(r"`(\.?[\w-]+(?:/[\w.-]+)+/?|[\w-]+\.(?:md|toml|cff))`")


def paths_in(text: str) -> set[str]:
    """Paths in backticks; those that are only a part of a name, or of a user's file, are left out."""
    return {path for path in PATH.findall(text) if "NAME" not in path and "FOLDER" not in path}


@pytest.mark.parametrize("name", TEXTS)
def test_paths_exist(name: str) -> None:
    text = (ROOT / name).read_text()
    lost = [
        path for path in sorted(paths_in(text)) if not (ROOT / path).exists() and path not in KINDS_OF_FILES
    ]
    links = re.findall(r"\]\((?!https?://|#)([^)#]+)", text)
    lost += [link for link in links if not (ROOT / name).parent.joinpath(link).exists()]
    assert not lost


KINDS_OF_FILES = {"regions.json", ".venv/installed-dev"}


def community_files() -> list[Path]:
    found = [
        ROOT / "CITATION.cff",
        *(ROOT / name for name in TEXTS),
        *(ROOT / ".github" / "ISSUE_TEMPLATE").glob("*"),
    ]
    return [*found, *(ROOT / "docker").glob("*"), *(ROOT / "notebooks").glob("*.ipynb")]


def test_the_repository_has_one_address() -> None:
    addresses = {
        address
        for path in community_files()
        for address in re.findall(
            r"https://(?:colab\.research\.google\.com/github|github\.com)/[\w-]+/scoup", path.read_text()
        )
    }
    assert addresses - {"https://colab.research.google.com/github/scoup/scoup"} == {REPOSITORY}


def test_the_citation_is_of_this_version_and_names_no_author_of_the_paper() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["cff-version"] == "1.2.0"
    assert str(citation["version"]) == VERSION
    assert citation["repository-code"] == REPOSITORY
    (author,) = citation["authors"]
    assert f'authors = [{{ name = "{author["name"]}" }}]' in (ROOT / "pyproject.toml").read_text()
    assert "not the paper's authors" in author["name"]
    (paper,) = citation["references"]
    assert [list(author) for author in paper["authors"]] == [["name"]]
    assert "2605.13600" in paper["url"]


def test_the_sentence_of_refusal_is_the_real_one() -> None:
    from scoup.base.errors import FieldVersionError

    assert f"> {FieldVersionError('FILE', 2, 1)}" in (ROOT / "docs" / "versions.md").read_text()
