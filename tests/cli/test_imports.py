"""What the verbs import: torch takes a second to start, scipy half of one."""

from __future__ import annotations

import sys

import pytest

from children import finished
from raster.parity import needs_native

pytestmark = pytest.mark.usefixtures("here")
HEAVY = ("torch", "scipy", "PIL", "transformers", "triton")
CODE = f"""
import sys
from scoup.cli.app import run
code = run(sys.argv[1:])
print([name for name in {HEAVY} if name in sys.modules], file=sys.stderr)
sys.exit(code)
"""


def imported(*arguments: str) -> str:
    done = finished([sys.executable, "-c", CODE, *arguments], check=True)
    assert done.stdout
    return done.stderr.splitlines()[-1]


@pytest.mark.parametrize("arguments", [["--help"], ["--version"], ["info", "--help"], ["info", "f.scoup"]])
def test_help_and_the_facts_of_a_field_need_nothing_heavy(arguments: list[str]) -> None:
    assert imported(*arguments) == "[]"


@needs_native
def test_a_query_needs_no_scipy() -> None:
    assert "scipy" not in imported("query", "f.scoup", "kettle")
