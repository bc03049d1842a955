"""Parsing: which verb, with which options."""

from __future__ import annotations

import sys
from typing import Annotated

import tyro

from scoup.cli.build import Build
from scoup.cli.console import Console, run_verb
from scoup.cli.demo import Demo
from scoup.cli.info import Info
from scoup.cli.query import Query
from scoup.cli.render import Render
from scoup.cli.select import Select

Verb = (
    Annotated[Demo, tyro.conf.subcommand("demo")]
    | Annotated[Build, tyro.conf.subcommand("build")]
    | Annotated[Query, tyro.conf.subcommand("query")]
    | Annotated[Select, tyro.conf.subcommand("select")]
    | Annotated[Render, tyro.conf.subcommand("render")]
    | Annotated[Info, tyro.conf.subcommand("info")]
)

DESCRIPTION = """Give a trained 3D Gaussian Splatting scene a language field, and ask it questions.

Try `scoup demo` first: it needs no data, network or GPU. Then, with a scene of your own:
  scoup build SCENE --gaussians point_cloud.ply --out scene.scoup
  scoup query scene.scoup "kettle" "wooden table" --camera all
  scoup select scene.scoup "kettle" --out kettle.ply

Exit codes: 0 done, 1 a fault of the program, 2 bad input, 130 interrupted."""


def run(arguments: list[str]) -> int:
    """Parse and run; returns the exit code."""
    if arguments in (["--version"], ["-V"]):
        from scoup import __version__

        print(f"scoup {__version__}")
        return 0
    verb = tyro.cli(
        Verb,  # pyright: ignore[reportArgumentType]
        prog="scoup",
        description=DESCRIPTION,
        args=arguments or ["--help"],
        config=(tyro.conf.FlagCreatePairsOff,),
        compact_help=False,
    )
    return run_verb(verb, verb, verb.run)


def entry() -> None:
    """The console script."""
    sys.exit(run(sys.argv[1:]))


__all__ = ["Console", "entry", "run"]
