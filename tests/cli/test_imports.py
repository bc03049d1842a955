"""What the verbs import: torch takes a second to start, scipy half of one."""

from __future__ import annotations

import sys

import pytest

from children import finished

pytestmark = pytest.mark.usefixtures("here")
HEAVY = ("torch", "scipy", "PIL", "transformers", "triton", "jinja2")
CODE = f"""
import sys
from scoup.cli.app import run
for command in sys.argv[1:]:
    assert run(command.split()) == 0
    print(command, [name for name in {HEAVY} if name in sys.modules], file=sys.stderr)
"""


def imported(*commands: str) -> list[str]:
    """Each command, and what of all that is heavy has been imported with it or before."""
    return finished([sys.executable, "-c", CODE, *commands], check=True).stderr.splitlines()


def test_help_and_the_facts_of_a_field_need_nothing_heavy() -> None:
    commands = ("--help", "--version", "info --help", "info f.scoup")
    assert imported(*commands) == [f"{command} []" for command in commands]
