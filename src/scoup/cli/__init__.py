"""The command line: one dataclass per verb. The laboratory's verbs are made of the same options and console.

Names are loaded when first used: signals are caught before the rest is imported.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from scoup.base import lazy_names

_HOMES = {
    "AllCommon": "scoup.cli.options",
    "CLIP_MODEL": "scoup.cli.options",
    "Console": "scoup.cli.console",
    "Family": "scoup.cli.family",
    "Names": "scoup.cli.options",
    "WritesCommon": "scoup.cli.options",
    "arg": "scoup.cli.options",
    "command": "scoup.cli.console",
    "entry": "scoup.cli.app",
}

__all__ = ["main", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from scoup.cli.app import entry as entry
    from scoup.cli.console import Console as Console
    from scoup.cli.console import command as command
    from scoup.cli.family import Family as Family
    from scoup.cli.options import CLIP_MODEL as CLIP_MODEL
    from scoup.cli.options import AllCommon as AllCommon
    from scoup.cli.options import Names as Names
    from scoup.cli.options import WritesCommon as WritesCommon
    from scoup.cli.options import arg as arg

__getattr__ = lazy_names(__name__, _HOMES)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``scoup``; returns the exit code (0 done, 1 fault, 2 bad input)."""
    from scoup.cli.app import run

    return run(list(sys.argv[1:] if arguments is None else arguments))
