"""The command line: one dataclass per verb."""

from __future__ import annotations

import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``scoup``; returns the exit code (0 done, 1 fault, 2 bad input)."""
    from scoup.cli.app import run

    return run(list(sys.argv[1:] if arguments is None else arguments))
