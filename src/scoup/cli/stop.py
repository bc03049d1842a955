"""Ctrl-C and SIGTERM end the program at any moment, without a traceback. This module imports little: it goes first."""

from __future__ import annotations

import os
import signal
import sys
import threading
import time
from types import FrameType

GRACE = 2.0
"""Seconds for threads that cannot be interrupted."""
_AGAIN = 0.02  # seconds until a signal that came during an import is looked at again


class Terminated(KeyboardInterrupt):
    """The process was asked to end (SIGTERM): cleaned up after as after an interruption."""


def stop_on_signals() -> None:
    """Let SIGINT raise KeyboardInterrupt and SIGTERM Terminated, though never within an import."""
    signal.signal(signal.SIGTERM, _stop)
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:  # as in the background of a shell
        signal.signal(signal.SIGINT, _stop)


def exit_code(stop: KeyboardInterrupt) -> int:
    """Return 143 for a terminated program, 130 for an interrupted one."""
    return 143 if isinstance(stop, Terminated) else 130


def end_soon(number: int) -> None:
    """End the process if a signal has not ended it after ``GRACE`` seconds, once no output is being written."""

    def end() -> None:
        locks = sys.modules.get("scoup.base.outputs")
        while locks is not None and locks.held:
            time.sleep(_AGAIN)
        os._exit(128 + number)

    timer = threading.Timer(GRACE, end)
    timer.daemon = True
    timer.start()


def _stop(number: int, frame: FrameType | None) -> None:
    if _is_importing(frame):
        # Libraries turn an exception in their import into another one, or into the end of the process.
        locks = sys.modules.get("scoup.base.outputs")
        if locks is None or not locks.held:
            os._exit(128 + number)  # no output was begun: there is nothing to clean up
        threading.Timer(_AGAIN, signal.raise_signal, [number]).start()
        return
    if number == signal.SIGTERM:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)  # once is enough; cleaning up is not to be cut short
        raise Terminated
    raise KeyboardInterrupt


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
