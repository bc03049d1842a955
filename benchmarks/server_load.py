"""A load test of `scoup view`: many visitors at once."""

from __future__ import annotations

import hashlib
import http.client
import json
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any, ClassVar
from urllib.parse import urlsplit

import numpy as np

import scoup
from benchmarks.study import Record, Study
from benchmarks.viewer import PROGRAM, VIEWS, served, write_field
from scoup.models.words import EVERYDAY_WORDS
from scoup.scene.cameras import Camera, Cameras
from scoup_lab.bench import markdown, random_scene_cameras, random_scene_gaussians

PASSED_ON = {503: "busy", 409: "superseded"}
WORDS = EVERYDAY_WORDS[:60]
ACTIONS = {
    "query": 50, "picture": 20, "point": 10, "thumbnail": 10, "page": 4, "scene": 2, "selection": 2, "walk away": 2
}  # fmt: skip
"""How often a visitor does what, in a hundred."""
MINUTES = 10
TIMEOUT = 120  # seconds for an answer


@dataclass
class Book:
    """The log of all visitors; several threads write."""

    counts: Counter[str] = field(default_factory=Counter)
    seconds: dict[str, list[float]] = field(default_factory=dict)
    errors: list[str] = field(default_factory=list)
    known: dict[str, str] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)

    def answered(self, action: str, question: str, status: int, content: bytes, seconds: float) -> None:
        """Write down an answer, after comparing it with an earlier one to the same question."""
        digest = hashlib.sha256(content).hexdigest()
        with self.lock:
            if status in PASSED_ON:
                self.counts[PASSED_ON[status]] += 1
            elif status not in (200, 204):
                self.errors.append(f"{action}: status {status}: {content[:200]!r}")
            elif self.known.setdefault(question, digest) != digest:
                self.errors.append(f"{action}: another answer to {question[:200]}")
            else:
                self.counts[action] += 1
                self.seconds.setdefault(action, []).append(seconds)


@dataclass(frozen=True)
class Visitor:
    """One client."""

    address: str  # of the server
    name: str  # its own, by which newer pictures replace older ones
    cameras: Sequence[dict[str, Any]]  # from which it looks, as JSON values
    dice: random.Random  # decides what it does
    book: Book  # for what comes back

    def visit(self, goes_on: Callable[[int], bool], pause: float) -> None:
        """Ask until ``goes_on`` (requests so far) says no."""
        done = 0
        while goes_on(done):
            (action,) = self.dice.choices(list(ACTIONS), list(ACTIONS.values()))
            try:
                self.act(action)
            except Exception as error:  # whatever it is: no visitor may meet it
                with self.book.lock:
                    self.book.errors.append(f"{action}: {type(error).__name__}: {error}")
            done += 1
            time.sleep(self.dice.expovariate(1 / pause) if pause > 0 else 0)

    def act(self, action: str) -> None:
        """Do one thing."""
        if action == "page":
            for path in ("", "viewer.js", "viewer.css", "api/vocabulary", "api/scene"):
                self.ask(action, "GET", path)
        elif action == "scene":
            self.ask(action, "GET", "scene.bin")
        elif action == "thumbnail":
            self.ask(action, "GET", f"api/thumbnail/{self.dice.randrange(len(self.cameras))}")
        else:
            path, message = self.question(action)
            self.ask(action, "POST", path, message, leaves=action == "walk away")

    def question(self, action: str) -> tuple[str, dict[str, Any]]:
        """Return (path, message) of what is asked by POST."""
        text = self.dice.choice(WORDS)
        camera = self.dice.choice(self.cameras)
        if action == "point":
            return "api/point", {
                "camera": camera,
                "pixel": [self.dice.randrange(160), self.dice.randrange(120)],
            }
        if action == "selection":
            return "api/select", {"texts": [text], "level": 0, "threshold": 0.6, "always": True}
        if action == "picture" or (action == "walk away" and self.dice.random() < 0.5):
            asked = {"texts": [text], "colors": [[255, 92, 40]], "always": True}
            return "api/render", {
                "camera": camera,
                "mode": self.dice.choice(["color", "heat", "mask"]),
                **asked,
            }
        return "api/query", {"texts": self.dice.sample(WORDS, self.dice.randint(1, 3)), "always": True}

    def ask(
        self, action: str, method: str, path: str, message: dict[str, Any] | None = None, leaves: bool = False
    ) -> None:
        """Send one request on a connection of its own."""
        parts = urlsplit(self.address)
        connection = http.client.HTTPConnection(str(parts.hostname), parts.port, timeout=TIMEOUT)
        body = None if message is None else json.dumps(message, sort_keys=True)
        headers = {"x-scoup-visitor": self.name} | (
            {} if body is None else {"content-type": "application/json"}
        )
        started = time.perf_counter()
        try:
            if leaves and self.dice.random() < 0.5:
                headers["content-length"] = str(
                    len(body or "") + 10
                )  # and leaves in the midst of its message
            connection.request(method, parts.path + path, body, headers)
            if leaves:
                with self.book.lock:
                    self.book.counts[action] += 1
                return
            answer = connection.getresponse()
            content = answer.read()
        finally:
            connection.close()
        self.book.answered(action, f"{path} {body}", answer.status, content, time.perf_counter() - started)


@dataclass(frozen=True, kw_only=True)
class ServerLoad(Study):
    """Send many visitors to `scoup view` at once: whether every answer is right, and whether its memory grows.

    The server runs in a process of its own, on the random scene with made-up codes. Each client is a visitor: it loads
    the page and the scene, asks for words, has pictures drawn, clicks, downloads selections, looks at thumbnails,
    pauses, and sometimes leaves before the answer has come, or in the middle of its message. The same question must get
    the same bytes from first to last. "Busy" (503) and "superseded" (409) are answers of the server that its page
    knows; everything else that is not the answer is an error, as is every word on the server's standard error. The
    command ends with 1 where there are errors. Latencies are those of a machine that clients and server share.
    """

    clients: int = 100
    """Visitors at once."""
    requests: int = 0
    """Requests of each visitor; 0 for as many as there is time for in ten minutes."""
    pause: float = 1.0
    """Mean seconds between an answer and the next question."""
    n_gaussians: int = 20_000
    """Of the scene."""
    seed: int = 0
    """Of what visitors do."""

    program: ClassVar[Sequence[str]] = PROGRAM
    """That is `scoup`."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        with tempfile.TemporaryDirectory() as folder:
            gaussians = random_scene_gaussians(self.n_gaussians)
            path = write_field(Path(folder), gaussians, random_scene_cameras(VIEWS, 320, 240))
            cameras = scoup.LanguageField.load(path).cameras
            assert cameras is not None
            log = Path(folder) / "log"
            with log.open("w") as stream, served(path, self.program, stream) as (address, process):
                book, samples = self._visits(address, process, cameras)
                said = log.read_text()  # at the end it says that it was terminated
        if said:
            book.errors.append(f"the server's standard error: {said[:2000]}")
        for error in book.errors[:10]:
            print(error, file=sys.stderr)
        yield "visits", figures(book, samples)

    def record(self, rows: dict[str, Any]) -> Record:
        return rows["visits"]

    @staticmethod
    def failed(record: Record) -> bool:
        return record["errors"] > 0

    @staticmethod
    def table(record: Record) -> str:
        """Return what was asked, a line per action; then the server."""
        rows = []
        for action, count in record["counts"].items():
            of = record["seconds"].get(action)
            times = (
                ["", "", ""]
                if of is None
                else [f"{of[name] * 1e3:,.0f}" for name in ("median", "p99", "worst")]
            )
            rows.append([action, f"{count:,}", *times])
        heads = ["answers", "number", "median, ms", "99th percentile", "worst"]
        server = record["server"]
        kinds = (
            ("resident memory, MB", "resident", 1e6),
            ("threads", "threads", 1),
            ("open files", "open_files", 1),
        )
        states = [
            [name, *(f"{server[when][key] / unit:,.0f}" for when in ("first", "middle", "last"))]
            for name, key, unit in kinds
        ]
        summary = (
            f"{record['settings']['clients']} clients, {record['server']['last']['seconds'] / 60:.1f} minutes, "
            f"{record['errors']} errors; memory {server['bytes_a_minute'] / 1e3:+.0f} kB a minute in the second half"
        )
        return "\n\n".join(
            [summary, markdown(heads, rows), markdown(["server", "first", "middle", "last"], states)]
        )

    def _visits(self, address: str, process: int, cameras: Cameras) -> tuple[Book, list[dict[str, float]]]:
        """Return what visitors have met, and the server's state every second."""
        book, samples = Book(), [state_of(process, 0.0)]
        records = [camera_record(camera) for camera in cameras]
        start = time.monotonic()

        def goes_on(done: int) -> bool:
            if self.requests:
                return done < self.requests
            return time.monotonic() - start < 60 * MINUTES

        threads = []
        for number in range(self.clients):
            dice = random.Random(f"{self.seed} {number}")
            visitor = Visitor(address, f"visitor {number}", records, dice, book)
            threads.append(threading.Thread(target=visitor.visit, args=(goes_on, self.pause)))
        for thread in threads:
            thread.start()
        while any(thread.is_alive() for thread in threads):
            time.sleep(1)
            samples.append(state_of(process, time.monotonic() - start))
        return book, samples


def camera_record(camera: Camera) -> dict[str, Any]:
    """Return a camera as the page sends it, its picture 160 pixels wide."""
    small = camera.resized(160, 120)
    matrices = {"viewmat": small.viewmat, "K": small.K}
    return {name: matrix.flatten().tolist() for name, matrix in matrices.items()} | {
        "width": small.width,
        "height": small.height,
    }


def state_of(process: int, seconds: float) -> dict[str, float]:
    """Return resident memory, open files and threads of a process."""
    status = Path(f"/proc/{process}/status").read_text().splitlines()
    fields = dict(line.split(":", 1) for line in status if line.startswith(("VmRSS", "Threads")))
    return {
        "seconds": seconds,
        "resident": int(fields["VmRSS"].split()[0]) * 1024,
        "threads": int(fields["Threads"]),
        "open_files": len(list(Path(f"/proc/{process}/fd").iterdir())),
    }


def figures(book: Book, samples: Sequence[dict[str, float]]) -> dict[str, Any]:
    """Return the record, for JSON."""
    half = samples[len(samples) // 2 :]
    slope = 0.0
    if len(half) > 1:
        slope = float(
            np.polyfit([each["seconds"] for each in half], [each["resident"] for each in half], 1)[0]
        )
    return {
        "counts": dict(sorted(book.counts.items())),
        "questions": len(book.known),
        "errors": len(book.errors),
        "first_errors": book.errors[:10],
        "seconds": {
            action: {"median": median(values), "p99": float(np.quantile(values, 0.99)), "worst": max(values)}
            for action, values in sorted(book.seconds.items())
        },
        "server": {"first": samples[0], "middle": half[0], "last": samples[-1], "bytes_a_minute": 60 * slope},
    }
