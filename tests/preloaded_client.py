"""``python preloaded_client.py SOCKET PYTHON ARGUMENT ...``: see ``preloaded.py``. Options of Python go to PYTHON."""

from __future__ import annotations

import json
import os
import signal
import socket
import struct
import sys

LENGTH = struct.Struct("<Q")


def main(address: str, python: str, arguments: list[str]) -> None:
    """Ends as the program does."""
    if not arguments or (arguments[0].startswith("-") and arguments[0] not in ("-c", "-m")):
        os.execv(python, [python, *arguments])
    request = {"arguments": arguments, "folder": os.getcwd(), "environment": dict(os.environ)}
    data = json.dumps(request).encode()
    with socket.socket(socket.AF_UNIX) as stream:
        stream.connect(address)
        socket.send_fds(stream, [LENGTH.pack(len(data))], [0, 1, 2])
        stream.sendall(data)
        program = number(stream)
        for passed_on in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(passed_on, lambda which, frame: os.kill(program, which))
        status = number(stream)
    if os.WIFSIGNALED(status):
        if os.WTERMSIG(status) != signal.SIGKILL:
            signal.signal(os.WTERMSIG(status), signal.SIG_DFL)
        os.kill(os.getpid(), os.WTERMSIG(status))
    os._exit(os.WEXITSTATUS(status))


def number(stream: socket.socket) -> int:
    """The next one."""
    data = b""
    while len(data) < LENGTH.size:
        part = stream.recv(LENGTH.size - len(data))
        if not part:
            sys.exit("the preloaded Python is gone")
        data += part
    return LENGTH.unpack(data)[0]


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3:])
