"""The page of scoup view beside the editors SuperSplat and Spark: bytes, first picture, memory, frames while moving."""

from __future__ import annotations

import gzip
import json
import math
import os
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlencode

import torch

import scoup
from benchmarks.chromium import COUNTER, chromium, frames_per_second, program, seconds_until_drawn
from benchmarks.data import data_folder
from benchmarks.study import Record, Study
from benchmarks.viewer import served, write_field
from scoup.base.errors import InputError
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.gaussians import Gaussians
from scoup.scene.rotations import quats_of_rotations
from scoup_lab.bench import markdown, random_scene_gaussians

if TYPE_CHECKING:
    from playwright.sync_api import Request

SIZE = (1280, 720)
FOV = 75.0  # degrees, of the height: that of Spark's editor
INDEX = "examples/editor/index.html"  # of Spark's editor, in its checkout
PATIENCE = 120.0
PACKED = (".js", ".css", ".html", ".json", ".wasm", ".svg")


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
            pages = [page for page in self._pages() if f"{name}/{page}" not in known]
            if not pages:
                continue
            gaussians = load()
            camera = looking_at(gaussians)
            with tempfile.TemporaryDirectory() as folder:
                for page in pages:
                    yield f"{name}/{page}", self._opened(page, gaussians, camera, Path(folder))

    def _pages(self) -> list[str]:
        editors = {"supersplat": self.supersplat, "spark": self.spark}
        return ["scoup", *(name for name, folder in editors.items() if folder is not None)]

    def _opened(self, page: str, gaussians: Gaussians, camera: Camera, folder: Path) -> dict[str, float]:
        if page == "scoup":
            path = write_field(folder, gaussians, Cameras([camera]))
            with served(path) as (address, server):
                found = page_costs(address, len(gaussians))
                return {**found, "server, MB": proportional_bytes(server) / 1e6}
        scoup.save_gaussians(gaussians, folder / "scene.ply", overwrite=True)
        if page == "supersplat":
            assert self.supersplat is not None
            with hosted(self.supersplat, folder) as host:
                address = f"{host}index.html?{urlencode({'load': host + 'scene.ply'})}"
                return page_costs(address, len(gaussians), supersplat_pose(camera))
        assert self.spark is not None
        with hosted(self.spark, folder) as host:
            query = {"url": host + "scene.ply", **spark_pose(camera)}
            return page_costs(f"{host}{INDEX}?{urlencode(query)}", len(gaussians))

    def record(self, rows: dict[str, Any]) -> Record:
        return {"versions": list(self.versions), "rows": rows}

    @staticmethod
    def table(record: Record) -> str:
        names = {"scoup": "scoup view", "supersplat": "SuperSplat", "spark": "Spark's editor"}
        body = []
        for name, row in record["rows"].items():
            scene, page = name.split("/")
            first, whole = row["first picture, s"], row["whole picture, s"]
            memory = f"{row['browser, MB']:,.0f}" + (
                f" + {row['server, MB']:,.0f}" if page == "scoup" else ""
            )
            sizes = [f"{row[what] / 1e6:.2f}" for what in ("program, bytes", "scene, bytes")]
            frames = f"{row['frames per second while moving']:.2f}"
            body.append([scene, names[page], *sizes, f"{first:.1f} / {whole:.1f}", memory, frames])
        heading = ["scene", "page", "program, MB", "scene, MB", "first / whole picture, s"]
        return markdown([*heading, "browser (+ server), MB", "frames per second while moving"], body)


def looking_at(gaussians: Gaussians) -> Camera:
    """Return a camera from which 90 % of the Gaussians are about as high as the picture, the y axis downwards."""
    centre = gaussians.means.double().median(0).values
    radius = float((gaussians.means.double() - centre).norm(dim=1).quantile(0.9)) if len(gaussians) else 1.0
    eye = centre + torch.tensor([0.3, -0.3, -1.0], dtype=torch.float64) * radius / math.tan(
        math.radians(FOV / 2)
    )
    focal = SIZE[1] / 2 / math.tan(math.radians(FOV / 2))
    return Camera.look_at(eye, centre, "front", *SIZE, focal, (0, -1, 0))


def spark_pose(camera: Camera) -> dict[str, float]:
    """Return the pose as Spark's editor takes it in its address; its cameras have OpenGL axes."""
    turned = camera.viewmat[:3, :3].T @ torch.diag(torch.tensor([1.0, -1.0, -1.0], dtype=torch.float64))
    w, x, y, z = quats_of_rotations(turned[None])[0].tolist()
    return {**dict(zip("xyz", camera.position.tolist(), strict=True)), "qx": x, "qy": y, "qz": z, "qw": w}


def supersplat_pose(camera: Camera) -> str:
    """Return a script that moves SuperSplat's camera; it turns splats upside down first."""
    ahead = camera.viewmat[2, :3]
    places = []
    for place in (camera.position, camera.position + ahead):
        x, y, z = place.tolist()
        places.append(json.dumps({"x": -x, "y": -y, "z": z}))
    return f"scene.camera.fov = {FOV}; scene.camera.setPose({places[0]}, {places[1]}, 0); scene.forceRender = true"


@contextmanager
def hosted(editor: Path, folder: Path) -> Iterator[str]:
    """Serve an editor's folder, packed as a web server does, and scene.ply of another one; yields the address."""
    handler = partial(_Packing, directory=str(editor), scene=folder / "scene.ply")
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}/"
    finally:
        server.shutdown()
        thread.join()


class _Packing(SimpleHTTPRequestHandler):
    """Sends what compresses as gzip."""

    def __init__(self, *values: Any, scene: Path, **options: Any) -> None:
        self.scene = scene
        super().__init__(*values, **options)

    def do_GET(self) -> None:
        path = self.scene if self.path.startswith("/scene.ply") else Path(self.translate_path(self.path))
        if not path.is_file():
            return super().do_GET()
        data, packs = path.read_bytes(), path.suffix in PACKED
        data = gzip.compress(data) if packs else data
        self.send_response(200)
        self.send_header("content-type", self.guess_type(str(path)))
        self.send_header("content-length", str(len(data)))
        if packs:
            self.send_header("content-encoding", "gzip")
        self.end_headers()
        with suppress(ConnectionError):
            self.wfile.write(data)
        return None

    def log_message(self, format: str, *args: Any) -> None:
        pass


def page_costs(address: str, count: int, pose: str = "") -> dict[str, float]:
    """Return the costs of a page that shows so many Gaussians.

    Args:
        address: of the page, with what it is to load.
        count: of the Gaussians.
        pose: a script that moves the camera.
    """
    with chromium() as browser:
        page = browser.new_page(viewport={"width": SIZE[0], "height": SIZE[1]})
        page.set_default_timeout(PATIENCE * 1000)
        asked: list[Request] = []
        page.on("requestfinished", lambda request: asked.append(request))
        page.add_init_script(COUNTER)
        page.goto(address)
        # Of a large scene, a coarse picture comes first; SuperSplat leaves out what is not in view.
        first = seconds_until_drawn(page, min(0.3 * count, 40_000), PATIENCE)
        page.evaluate("window.scoupViewer?.whole")
        whole = seconds_until_drawn(page, 0.3 * count, PATIENCE)
        if pose:
            page.evaluate(pose)
            page.wait_for_timeout(1000)
        frames = frames_per_second(page, (SIZE[0] // 3, SIZE[1] // 2))
        memory = sum(map(proportional_bytes, _descendants(os.getpid(), "chrom")))
        sizes = [(request.url, _size(request)) for request in asked]
    scene = sum(size for url, size in sizes if "scene.bin" in url or url.endswith("scene.ply"))
    return {
        "program, bytes": sum(size for _, size in sizes) - scene,
        "scene, bytes": scene,
        "first picture, s": first,
        "whole picture, s": whole,
        "browser, MB": memory / 1e6,
        "frames per second while moving": frames,
    }


def _size(request: Request) -> int:
    """Return the bytes of an answer as sent; the browser does not know them of every one that a page reads in parts."""
    response = request.response()
    announced = 0 if response is None else int(response.headers.get("content-length", "0"))
    return max(request.sizes()["responseBodySize"], announced)


def _descendants(process: int, name: str) -> list[int]:
    """Return the processes below one whose program has such a name."""
    parents: dict[int, int] = {}
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            parents[int(folder.name)] = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
    below, found = {process}, []
    for own in sorted(parents):  # children usually have larger numbers; a second pass finds the others
        if parents[own] in below:
            below.add(own)
    for own, parent in parents.items():
        if parent in below:
            below.add(own)
    for own in below:
        with suppress(OSError):
            if name in os.readlink(f"/proc/{own}/exe"):
                found.append(own)
    return found


def proportional_bytes(process: int) -> int:
    """Return the memory of a process; what it shares with others counts by its share (PSS)."""
    with suppress(OSError):
        for line in Path(f"/proc/{process}/smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1]) * 1024
    return 0
