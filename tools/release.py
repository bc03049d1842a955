"""What a release needs from the sources: is everything set for a tag, and what does the changelog say of it?

python tools/release.py check TAG     the tag is "v" and the version, and the changelog has a dated heading for it
python tools/release.py notes TAG     what the changelog says of that version, as Markdown
"""

from __future__ import annotations

import argparse
import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


class NotReady(Exception):
    """The sources are not those of the release; the text says why."""


def version(pyproject: str) -> str:
    """Return the version that pyproject.toml states."""
    found = re.search(r'^version = "([^"]+)"$', pyproject, re.MULTILINE)
    if found is None:
        raise NotReady("pyproject.toml states no version")
    return found[1]


def section(changelog: str, wanted: str) -> tuple[str, str]:
    """Return what stands behind a version in its heading, and the text below."""
    found = re.search(
        rf"^## {re.escape(wanted)}(?P<rest>[^\w.\n][^\n]*)?\n(?P<text>.*?)(?=^## |\Z)",
        changelog,
        re.MULTILINE | re.DOTALL,
    )
    if found is None or not found["text"].strip():
        raise NotReady(f"CHANGELOG.md has nothing under a heading '## {wanted}'")
    return (found["rest"] or "").strip(), found["text"].strip()


def check(tag: str, pyproject: str, changelog: str) -> None:
    """Refuse, by a NotReady, a tag that may not be released from these sources."""
    stated = version(pyproject)
    if tag != f"v{stated}":
        raise NotReady(
            f"the tag is {tag}, but pyproject.toml states version {stated}: it should be v{stated}"
        )
    behind, _ = section(changelog, stated)
    if re.fullmatch(r"\(\d{4}-\d{2}-\d{2}\)", behind) is None:
        raise NotReady(
            f"the heading of {stated} in CHANGELOG.md ends with {behind or 'nothing'!r}; "
            "put the date there: (2026-01-31)"
        )


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("what", choices=("check", "notes"))
    parser.add_argument("tag")
    options = parser.parse_args(arguments)
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    try:
        if options.what == "check":
            check(options.tag, (ROOT / "pyproject.toml").read_text(encoding="utf-8"), changelog)
        else:
            print(section(changelog, options.tag.removeprefix("v"))[1])
    except NotReady as reason:
        print(reason, file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
