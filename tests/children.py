"""Processes that tests start: all are killed when their block ends, whatever happened in it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from subprocess import PIPE
from typing import IO, Any


class Child(subprocess.Popen[Any]):
    """A program. The streams that a test uses are pipes."""

    stdin: IO[Any]  # pyright: ignore[reportIncompatibleVariableOverride]
    stdout: IO[Any]  # pyright: ignore[reportIncompatibleVariableOverride]
    stderr: IO[Any]  # pyright: ignore[reportIncompatibleVariableOverride]


@contextmanager
def child(command: Sequence[object], **options: Any) -> Iterator[Child]:
    """A program with pipes as its output, by default of text. Programs that it starts are killed with it."""
    options = {"stdout": PIPE, "stderr": PIPE, "text": True, **options}
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:  # as in jobs in the background of a shell, and in what they start
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        process = Child([str(part) for part in command], start_new_session=True, **options)
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        yield process
    finally:
        with suppress(ProcessLookupError, PermissionError):  # it has ended already
            if hasattr(os, "killpg"):
                os.killpg(process.pid, signal.SIGKILL)
            else:
                process.kill()
        process.wait()
        for stream in (process.stdin, process.stdout, process.stderr):
            if stream is not None:
                with suppress(OSError):  # what was not written to it yet
                    stream.close()


def finished(
    command: Sequence[object], check: bool = False, **options: Any
) -> subprocess.CompletedProcess[Any]:
    """A program that has ended; options of ``child``. With ``check``, it must succeed."""
    with child(command, **options) as process:
        out, err = process.communicate()
    assert not (check and process.returncode), f"{out}{err}"
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


@contextmanager
def workers(count: int, initializer: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """Processes that have imported torch and scoup already; elsewhere than on Linux, they import them."""
    context = get_context("spawn")
    if sys.platform.startswith("linux"):
        context = get_context("forkserver")
        context.set_forkserver_preload(["scoup.uplift.field_build"])
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=initializer)
    try:
        yield pool
    finally:
        for process in list((pool._processes or {}).values()):
            process.kill()
        pool.shutdown(cancel_futures=True)


def forked(work: Callable[[], int]) -> int:
    """The exit code of a fork of this process that does some work; negative: the signal that has ended it."""
    process = os.fork()
    if not process:
        try:
            os._exit(work())
        finally:  # after an error
            os._exit(255)
    try:
        return os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
    except BaseException:
        os.kill(process, signal.SIGKILL)
        os.waitpid(process, 0)
        raise
