"""gsplat compiled ahead, in a process of its own: its wheel compiles itself with nvcc when first used, for minutes.

python -m benchmarks.gpu.peer_building      # compiles, renders and goes backward once; says what came of it
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).resolve().parents[2]
MISSING = "gsplat is not installed (pip install gsplat; it needs nvcc)"


class PeerBuilding:
    """The process that compiles; what it prints is kept for the reason if it fails."""

    def __init__(
        self, command: tuple[str, ...] = (sys.executable, "-m", "benchmarks.gpu.peer_building")
    ) -> None:
        self._command = command
        self._process: subprocess.Popen[bytes] | None = None
        self._log: IO[bytes] | None = None
        self._started = time.time()

    def start(self) -> None:
        """Begin, where gsplat is installed."""
        if importlib.util.find_spec("gsplat") is None:
            return
        self._log = tempfile.TemporaryFile()  # noqa: SIM115  it is read when the process has ended
        self._process = subprocess.Popen(
            self._command, cwd=ROOT, stdout=self._log, stderr=subprocess.STDOUT, start_new_session=True
        )

    def finish(self, latest: float) -> dict[str, Any]:
        """Wait until it has ended, or until then (seconds since the epoch).

        Returns:
            "seconds" it took, and "reason": why gsplat cannot be used, "" where it can.
        """
        if self._process is None:
            return {"reason": MISSING}
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(max(0.0, latest - time.time()))
        code = self._process.poll()
        found: dict[str, Any] = {"seconds": time.time() - self._started, "reason": ""}
        if code is None:
            found["reason"] = f"gsplat was not compiled within {found['seconds']:.0f} s"
        elif code:
            found["reason"] = f"gsplat does not work here: {self._error()}"
        self.stop()
        return found

    def stop(self) -> None:
        """End it, and the compilers that it has started."""
        if self._process is not None:
            with contextlib.suppress(OSError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
            self._process = None

    def _error(self) -> str:
        assert self._log is not None
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").splitlines()
        errors = [line for line in lines if re.search(r"error|fatal", line, re.IGNORECASE)]
        return " | ".join(line.strip()[:300] for line in (errors[:3] + lines[-2:]))[:1500]


def main() -> None:
    """Compile for the GPU that is there, on all processors but two, and try what is used of it."""
    import torch

    from benchmarks.gpu.peers import Gsplat
    from scoup.bench import random_scene_cameras, random_scene_gaussians

    os.environ.setdefault("MAX_JOBS", str(max(1, (os.cpu_count() or 1) - 2)))
    device = torch.device("cuda")
    peer = Gsplat.found(device)
    gaussians = random_scene_gaussians(100).to(device)
    values = torch.zeros(100, 40, device=device, requires_grad=True)  # more than are drawn at a time
    image = peer.render(gaussians, random_scene_cameras(1, 32, 32)[0], values)
    (gradient,) = torch.autograd.grad(image, values, torch.ones_like(image))
    if not float(gradient.sum()) > 0:
        sys.exit("error: the gradients of gsplat's render are zero")
    print(f"gsplat {peer.version} works here")


if __name__ == "__main__":
    main()
