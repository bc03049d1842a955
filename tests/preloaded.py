"""A Python that has imported torch and scoup already: the programs of tests begin at once, in processes of their own.

    python tests/preloaded.py SOCKET PYTHON     wait for requests, and fork a process for each

``PYTHON`` is what such programs find as ``sys.executable``: ``preloaded_client.py`` behind a shell script. It hands on
arguments, environment, folder and streams, passes signals on, and ends as the program does. If it is killed, the
program is killed, too. A program is a session of its own: one that kills its group, as Ray does, ends nobody else.
Nothing is preloaded that reads the environment when imported.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import io
import json
import os
import runpy
import select
import signal
import socket
import struct
import sys
import threading
import types
from dataclasses import dataclass
from typing import Literal

MODULES = (
    "torch", "scipy.ndimage", "scipy.sparse", "scipy.spatial", "PIL.Image", "yaml", "rich.progress", "rich.table",
    "tyro", "scoup.cli.app", "scoup.cli.build", "scoup.cli.transfer", "scoup.cli.extract", "scoup.cli.query",
    "scoup.io", "scoup.models.text", "scoup.uplift.field_build", "scoup.uplift.field_transfer", "scoup.uplift.fit",
    "scoup.extract.pipeline", "scoup.extract.registry", "scoup.query.language_field",
)  # fmt: skip
IF_INSTALLED = ("skimage.segmentation",)
LENGTH = struct.Struct("<Q")


@dataclass(frozen=True)
class Request:
    """What a program is started with.

    Attributes:
        arguments: those of Python.
        folder: the current one.
        environment: its variables.
        streams: numbers of standard input, output and error.
    """

    arguments: list[str]
    folder: str
    environment: dict[str, str]
    streams: list[int]


def serve(address: str) -> Request:
    """Fork for ever; returns in each process that is to run a program."""
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(address)
        listener.listen(64)
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for those who watch
        print("ready", flush=True)
        while True:
            connection, _ = listener.accept()
            if os.fork() == 0:
                break
            connection.close()
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    request = received(connection)
    program = os.fork()
    if program == 0:
        os.setsid()
        connection.close()
        return request
    watch(connection, program)
    os._exit(0)


def received(connection: socket.socket) -> Request:
    """What a client has sent."""
    head, streams, _, _ = socket.recv_fds(connection, LENGTH.size, 3)
    data = b""
    while len(data) < LENGTH.unpack(head)[0]:
        data += connection.recv(1 << 16)
    return Request(**json.loads(data), streams=list(streams))


def watch(connection: socket.socket, program: int) -> None:
    """Tell the client how the program ends; kill the program if the client is killed."""
    for stream in range(3):
        os.close(stream)
    connection.sendall(LENGTH.pack(program))
    end = os.pidfd_open(program)
    ready, _, _ = select.select([connection, end], [], [])
    if end not in ready:
        os.kill(program, signal.SIGKILL)
    _, status = os.waitpid(program, 0)
    if end in ready:
        connection.sendall(LENGTH.pack(status))


def become(request: Request, python: str) -> None:
    """Take over what the program is started with."""
    os.chdir(request.folder)
    os.environ.clear()
    os.environ.update(request.environment)
    for number, stream in enumerate(request.streams):
        os.dup2(stream, number)
        os.close(stream)
    sys.stdin = sys.__stdin__ = io.TextIOWrapper(io.BufferedReader(stream_of(0, "r")), "utf-8")
    out, err = (io.BufferedWriter(stream_of(number, "w")) for number in (1, 2))
    at_once = bool(os.environ.get("PYTHONUNBUFFERED"))
    sys.stdout = sys.__stdout__ = io.TextIOWrapper(
        out, "utf-8", line_buffering=at_once or os.isatty(1), write_through=at_once
    )
    sys.stderr = sys.__stderr__ = io.TextIOWrapper(err, "utf-8", "backslashreplace", line_buffering=True)
    sys.executable = python
    here = os.path.dirname(os.path.abspath(__file__))
    before = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    sys.path[:] = before + [path for path in sys.path if path not in (here, *before)]


def stream_of(number: int, mode: Literal["r", "w"]) -> io.FileIO:
    """One of the three, which stays open."""
    return io.FileIO(number, mode, closefd=False)


def run(arguments: list[str]) -> None:
    """``python ARGUMENTS``: a script, or one of -c and -m."""
    first, rest = arguments[0], arguments[1:]
    if first == "-c":
        sys.argv = ["-c", *rest[1:]]
        sys.path.insert(0, "")
        main = sys.modules["__main__"] = types.ModuleType("__main__")
        exec(compile(rest[0], "<string>", "exec"), main.__dict__)
    elif first == "-m":
        sys.argv = rest
        sys.path.insert(0, os.getcwd())
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    else:
        sys.argv = arguments
        sys.path.insert(0, os.path.dirname(os.path.abspath(first)))
        runpy.run_path(first, run_name="__main__")


def ended(arguments: list[str]) -> int:
    """Run and end as Python would, but for taking apart everything that was imported, which takes a second."""
    code = 0
    try:
        run(arguments)
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        if isinstance(stop.code, str):
            print(stop.code, file=sys.stderr)
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
        code = 1
        if isinstance(error, KeyboardInterrupt):
            signal.signal(signal.SIGINT, signal.SIG_DFL)
            os.kill(os.getpid(), signal.SIGINT)
    threading._shutdown()  # pyright: ignore[reportAttributeAccessIssue]
    atexit._run_exitfuncs()
    sys.stdout.flush()
    return code


if __name__ == "__main__":
    for module in (*MODULES, *IF_INSTALLED):
        with contextlib.suppress(*((ImportError,) if module in IF_INSTALLED else ())):
            importlib.import_module(module)
    gc.freeze()  # no program need look through all of this for garbage
    given = serve(sys.argv[1])
    become(given, sys.argv[2])
    os._exit(ended(given.arguments))
