"""The program: its verbs, its description, its exit codes."""

from __future__ import annotations

import contextlib
import io
import os
import sys

from scoup.cli.family import Family
from scoup.cli.stop import exit_code, stop_on_signals

DESCRIPTION = """Give a trained 3D Gaussian Splatting scene a language field, and query it.

Try `scoup demo` first: it needs no data, network or GPU. Then, with a scene of your own:

  scoup views point_cloud.ply --out SCENE      (without photographs)
  scoup extract SCENE
  scoup build SCENE --gaussians point_cloud.ply --out scene.scoup
  scoup frame scene.scoup --thing door --longest-side 2.0
  scoup query scene.scoup "kettle" "wooden table" --camera all
  scoup select scene.scoup "kettle" --out kettle.ply
  scoup label scene.scoup "kettle" "wooden table"
  scoup catalog scene.scoup
  scoup render scene.scoup --what codes --camera all
  scoup view scene.scoup
  scoup mcp scene.scoup
  scoup batch SCANS --out FIELDS --archive DIR
  scoup archive DIR "kettle"
  scoup compare old.scoup new.scoup
  scoup info scene.scoup
  scoup eval lerf-ovs ROOT

`scoup VERB --help` explains a verb. Exit codes: 0 done, 1 internal error, 2 bad input, 130
interrupted, 143 terminated."""

SCOUP = Family(
    DESCRIPTION,
    {
        "demo": "scoup_lab.cli.demo:Demo",
        "views": "scoup.cli.views:MakeViews",
        "extract": "scoup.cli.extract:Extract",
        "words": "scoup.cli.words:MakeWords",
        "convert": "scoup.cli.convert:Convert",
        "build": "scoup.cli.build:Build",
        "transfer": "scoup.cli.transfer:Transfer",
        "frame": "scoup.cli.frame:Frame",
        "query": "scoup.cli.query:Query",
        "select": "scoup.cli.select:Select",
        "label": "scoup.cli.label:Label",
        "catalog": "scoup.cli.catalog:MakeCatalog",
        "render": "scoup.cli.render:Render",
        "view": "scoup.cli.view:View",
        "mcp": "scoup.cli.mcp:ServeAgents",
        "batch": "scoup.cli.batch:Batch",
        "archive": "scoup.cli.archive:SearchArchive",
        "compare": "scoup.cli.compare:CompareCaptures",
        "info": "scoup.cli.info:Info",
        "eval": "scoup_lab.cli.evaluate:EVAL",
    },
)


def run(arguments: list[str]) -> int:
    """Parse and run; returns the exit code."""
    if arguments in (["--version"], ["-V"]):
        from scoup.base import VERSION

        print(f"scoup {VERSION}")
        return 0
    from scoup.base import printable
    from scoup.cli.console import Console, run_verb
    from scoup.cli.options import Common
    from scoup.cli.parsing import in_one_line, parse

    for_machines = "--json" in arguments
    refusal = io.StringIO()
    try:
        with contextlib.redirect_stderr(refusal):
            verb = parse(arguments, SCOUP, "scoup")
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else 0
        if for_machines and code:
            said = f"{in_one_line(refusal.getvalue())}; see scoup --help, or scoup VERB --help"
            Console(Common(as_json=True)).fail(said, code)
        else:
            print(printable(refusal.getvalue()), end="", file=sys.stderr)
        return code
    return run_verb(verb.common, verb.run)


def entry() -> None:
    """Run the console script."""
    stop_on_signals()
    from scoup.cli.console import silence

    _fill_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # File names and texts may hold letters that the terminal's encoding lacks.
            stream.reconfigure(errors="backslashreplace")
    try:
        code = run(sys.argv[1:])
        sys.stdout.flush()
    except KeyboardInterrupt as stop:  # before a verb has begun
        code = exit_code(stop)
    except BrokenPipeError:  # whoever read the help, such as head, has seen enough
        silence(sys.stdout)
        code = 0
    except OSError as error:  # nowhere to print the help to
        silence(sys.stdout)
        print(f"error: standard output: cannot be written ({error.strerror or error})", file=sys.stderr)
        code = 2
    sys.exit(code)


def _fill_closed_streams() -> None:
    """Open standard streams that the caller has closed: the first files that are opened would take their places."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            opened = os.open(os.devnull, os.O_RDWR)
            if opened != number:
                os.dup2(opened, number)
                os.close(opened)
            setattr(sys, name, open(number, "r" if name == "stdin" else "w", closefd=False))  # noqa: SIM115
