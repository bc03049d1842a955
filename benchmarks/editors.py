"""The page of scoup view beside the editors SuperSplat and Spark: bytes, first picture, memory, frames while moving."""

from __future__ import annotations

import gzip
import json
import math
import re
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import torch

import scoup
from benchmarks.chromium import COUNTER, chromium, drag, program, seconds_until_drawn
from benchmarks.data import data_folder
from benchmarks.study import Record, Study
from benchmarks.viewer import served, write_field
from scoup.base.errors import InputError
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup_lab.bench import markdown, random_scene_gaussians

if TYPE_CHECKING:
    from playwright.sync_api import Browser

SIZE = (1280, 720)
PLACE = (SIZE[0] // 3, SIZE[1] // 2)  # where the pointer drags
FOV = 75.0  # degrees, of the height: that of Spark's editor
PATIENCE = 120.0
NAMES = {"scoup": "scoup view", "supersplat": "SuperSplat", "spark": "Spark's editor"}


@dataclass(frozen=True, kw_only=True)
class Editors(Study):
    """Open the same splat in the page of scoup view, in SuperSplat and in Spark's editor, in the same Chromium,
    which draws without a GPU, from the same camera, at 1280 x 720.

    SuperSplat: its repository after `npm install` and `npm run build`. Spark: its repository with `dist` built, or of
    the npm package of the same version, and three, lil-gui and stats.js in examples/js/vendor. Neither is in this one.
    """

    supersplat: Path | None = None
    """Folder `dist` of SuperSplat; without it, SuperSplat is left out."""
    spark: Path | None = None
    """Folder of Spark; without it, its editor is left out."""
    versions: tuple[str, ...] = ()
    """Of the editors, for the record."""
    n_gaussians: int = 1_000_000
    """Of the random scene."""
    data: Path = field(default_factory=data_folder)
    """Folder that contains guitar/."""

    def check(self) -> None:
        if program() is None:
            raise InputError("no Chromium was found")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        scenes = {"guitar": lambda: scoup.load_gaussians(self.data / "guitar" / "guitar.ply")}
        scenes["random"] = lambda: random_scene_gaussians(self.n_gaussians)
        for name, load in scenes.items():
            gaussians = load()
            camera = camera_in_front(gaussians)
            with tempfile.TemporaryDirectory() as folder:
                for page in NAMES:
                    if f"{name}/{page}" not in known and (page == "scoup" or getattr(self, page)):
                        yield f"{name}/{page}", self._costs(page, gaussians, camera, Path(folder))

    def _costs(self, page: str, gaussians: Gaussians, camera: Camera, folder: Path) -> dict[str, float]:
        count = len(gaussians)
        if page == "scoup":
            with served(write_field(folder, gaussians, Cameras([camera]))) as (address, server):
                return {**page_costs(address, count), "server, MB": proportional_bytes(server) / 1e6}
        site = folder / page
        site.mkdir()
        for path in getattr(self, page).absolute().iterdir():
            (site / path.name).symlink_to(path)
        scoup.save_gaussians(gaussians, site / "scene.ply")
        x, y, z = camera.position.tolist()
        with hosted(site) as host:
            scene = f"{host}/scene.ply"
            if page == "spark":  # its cameras look the other way, the y axis upwards
                query = {"url": scene, "x": x, "y": y, "z": z, "qx": 1, "qy": 0, "qz": 0, "qw": 0}
                return page_costs(f"{host}/examples/editor/index.html?{urlencode(query)}", count)
            # It turns splats upside down.
            place, target = (json.dumps({"x": -x, "y": -y, "z": depth}) for depth in (z, z + 1))
            moved = f"scene.camera.fov = {FOV}; scene.camera.setPose({place}, {target}, 0); scene.forceRender = true"
            return page_costs(f"{host}/index.html?{urlencode({'load': scene})}", count, moved)

    def record(self, rows: dict[str, Any]) -> Record:
        return {"versions": list(self.versions), "rows": rows}

    @staticmethod
    def table(record: Record) -> str:
        body = []
        for name, row in record["rows"].items():
            scene, page = name.split("/")
            server = f" + {row['server, MB']:,.0f}" if "server, MB" in row else ""
            body.append(
                [
                    scene,
                    NAMES[page],
                    *(f"{row[what] / 1e6:.2f}" for what in ("program, bytes", "scene, bytes")),
                    f"{row['first picture, s']:.1f} / {row['whole picture, s']:.1f}",
                    f"{row['browser, MB']:,.0f}{server}",
                    f"{row['browser until the whole picture, CPU s']:.1f}",
                    f"{row['a frame while moving, CPU s']:.2f}",
                    f"{row['frames per second while moving']:.2f}",
                ]
            )
        heading = ["scene", "page", "program, MB", "scene, MB", "first / whole picture, s"]
        heading += [
            "browser (+ server), MB",
            "loading, CPU s",
            "a moving frame, CPU s",
            "moving frames per second",
        ]
        return markdown(heading, body)


def camera_in_front(gaussians: Gaussians) -> Camera:
    """Return a camera along the z axis from which 90 % of the Gaussians are about as high as the picture."""
    centre = gaussians.means.double().median(0).values
    radius = (gaussians.means.double() - centre).norm(dim=1).quantile(0.9)
    slope = math.tan(math.radians(FOV / 2))
    focal = SIZE[1] / 2 / slope
    K = torch.tensor([[focal, 0, SIZE[0] / 2], [0, focal, SIZE[1] / 2], [0, 0, 1]], dtype=torch.float64)
    viewmat = torch.eye(4, dtype=torch.float64)
    viewmat[:3, 3] = -centre
    viewmat[2, 3] += radius / slope
    return Camera("front", viewmat, K, *SIZE)


@contextmanager
def hosted(folder: Path) -> Iterator[str]:
    """Serve a folder; yields the address."""
    command = [
        sys.executable,
        "-u",
        "-m",
        "http.server",
        "0",
        "--bind",
        "127.0.0.1",
        "--directory",
        str(folder),
    ]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        assert process.stdout is not None
        try:
            yield process.stdout.readline().split("(")[1].split("/)")[0]
        finally:
            process.terminate()


def page_costs(address: str, count: int, moved: str = "") -> dict[str, float]:
    """Return the costs of a page that shows so many Gaussians; its files count as packed with gzip.

    Args:
        address: of the page, with what it is to load.
        count: of the Gaussians.
        moved: a script that moves the camera.
    """
    with chromium() as browser:
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        page.set_default_timeout(PATIENCE * 1000)
        asked: list[str] = []
        page.on("request", lambda request: asked.append(request.url))
        page.add_init_script(COUNTER)
        page.goto(address)
        # Of a large scene, a coarse picture comes first; SuperSplat leaves out what is not in view.
        first = seconds_until_drawn(page, min(0.3 * count, 40_000), PATIENCE)
        page.evaluate("window.scoupViewer?.whole")
        whole = seconds_until_drawn(page, 0.3 * count, PATIENCE)
        loading = processor_seconds(browser)
        page.evaluate(moved)
        page.wait_for_timeout(1000)
        drag(page, PLACE)  # pages may find that frames are slow, and draw less from then on
        before = processor_seconds(browser)
        frames, seconds = drag(page, PLACE)
        spent = processor_seconds(browser) - before
        memory = sum(proportional_bytes(process["id"]) for process in processes(browser))
    files = [url for url in dict.fromkeys(asked) if url.startswith("http") and "/api/" not in url]
    scenes = [url for url in files if re.search(r"scene\.(bin|ply)(\?|$)|/part/", url)]
    return {
        "program, bytes": sum(len(gzip.compress(_read(url))) for url in files if url not in scenes),
        "scene, bytes": sum(len(_read(url)) for url in scenes),
        "first picture, s": first,
        "whole picture, s": whole,
        "browser, MB": memory / 1e6,
        "browser until the whole picture, CPU s": loading,
        "frames per second while moving": frames / seconds,
        "a frame while moving, CPU s": spent / max(1, frames),
    }


def processes(browser: Browser) -> list[dict[str, Any]]:
    """Return the processes of a browser, each with its `id` and its `cpuTime` in seconds."""
    return browser.new_browser_cdp_session().send("SystemInfo.getProcessInfo")["processInfo"]


def processor_seconds(browser: Browser) -> float:
    """Return the CPU seconds that a browser has used."""
    return sum(process["cpuTime"] for process in processes(browser))


def _read(url: str) -> bytes:
    with urllib.request.urlopen(url) as answer:
        return answer.read()


def proportional_bytes(process: int) -> int:
    """Return the memory of a process; what it shares with others counts by its share (PSS)."""
    found = re.search(r"^Pss: +(\d+)", Path(f"/proc/{process}/smaps_rollup").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1]) * 1024
