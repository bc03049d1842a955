"""A browser for tests of the viewer, a small scene of named things, and the page as a visitor sees it."""

from __future__ import annotations

import base64
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

import numpy as np
import pytest
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup import raster
from scoup.field import NO_THING, FieldInfo
from scoup.io import load_gaussians
from scoup.models import CANONICAL_PHRASES, WordTable
from scoup.pictures import Picture, as_picture
from scoup.query import LanguageField
from scoup.scene import SH_C0, Camera, Cameras, Gaussians, index_dtype
from support import gaussians_at, things_of, unit

if TYPE_CHECKING:
    from playwright.sync_api import Browser, ConsoleMessage, Locator, Page, Route

    from scoup.view.viewed_field import ViewedField
    from scoup.view.viewer import Viewer
else:  # where it is not installed, tests that name its types are skipped
    Browser = Page = Route = Any

DIM = 48
THINGS = {  # name: place, colour
    "kettle": ((-0.8, 0.0, 0.6), (0.8, 0.2, 0.2)),
    "mug": ((0.8, 0.0, 0.6), (0.2, 0.7, 0.2)),
    "book": ((-0.8, 0.0, -0.6), (0.2, 0.3, 0.8)),
    "lamp": ((0.8, 0.0, -0.6), (0.7, 0.6, 0.2)),
}
GROUPS = {"dishes": ("kettle", "mug"), "furniture": ("book", "lamp")}
"""What the coarsest level knows the things as."""
ABSENT = "violin"
FILLERS = tuple(f"filler {number}" for number in range(24))
MIXED = "pot"
"""Mostly a kettle, a little a mug: how much of it is selected depends on the threshold."""
WORDS = (*THINGS, *GROUPS, ABSENT, *FILLERS)
A_THING = 60
"""Gaussians of each thing."""
PATIENCE = 60_000
"""Milliseconds for a step, on however busy a machine."""


# ---- The scene


@cache
def table() -> dict[str, Tensor]:
    """A word table: the names above and the canonical phrases; nobody changes it."""
    names = (*WORDS, *CANONICAL_PHRASES)
    generator = torch.Generator().manual_seed(11)
    vectors = unit(torch.randn(len(names), DIM, generator=generator))
    # Orthogonal, as long as there are dimensions.
    vectors = torch.linalg.qr(vectors[:DIM].T).Q.T
    found = dict(zip(names, vectors, strict=True))
    return found | {MIXED: unit(0.9 * found["kettle"] + 0.42 * found["mug"])}


def things_field() -> LanguageField:
    """Four balls of Gaussians, each a thing; two groups of two at the coarsest level."""
    generator = torch.Generator().manual_seed(3)
    places = [torch.tensor(place) for place, _ in THINGS.values()]
    directions = unit(torch.randn(A_THING, 3, generator=generator))
    means = torch.cat([place + 0.22 * directions for place in places])
    colors = torch.cat([torch.tensor(color).expand(A_THING, 3) for _, color in THINGS.values()])
    colors = (colors + 0.05 * torch.randn(colors.shape, generator=generator)).clamp(0, 1)
    gaussians = splat(means, 0.07, colors)
    owner = torch.arange(len(THINGS)).repeat_interleave(A_THING)
    groups = [list(GROUPS).index(group) for name in THINGS for group, own in GROUPS.items() if name in own]
    main = torch.stack([owner, owner, len(THINGS) + torch.tensor(groups)[owner]], 1)  # [N, 3 levels]
    return coded(gaussians, main, generator, views())


def field_of_instances() -> LanguageField:
    """``things_field`` with instances that select other Gaussians than the votes do.

    That of the kettle has every second Gaussian of the book, too, a few of which have no code; the lamp has none.
    Each is a part of the same thing at the next coarser level.
    """
    field = things_field()
    place = torch.arange(len(field))
    book = (place // A_THING == list(THINGS).index("book")) & (place % 2 == 0)
    field.code_weights[book & (place % 10 == 0)] = 0
    main = torch.where(book, 0, place // A_THING)
    main = torch.where(main == list(THINGS).index("lamp"), NO_THING, main)
    names = list(THINGS)[:3]
    owners = torch.stack([torch.where(main < 0, NO_THING, main + shift) for shift in (0, 3, 6)], 1)
    count = 3 * len(names)
    field.thing_table = things_of(
        owners,
        torch.arange(3).repeat_interleave(len(names)),
        torch.stack([table()[name] for name in names * 3]),
        parents=torch.tensor([3, 4, 5, 6, 7, 8, *[NO_THING] * 3], dtype=torch.int32),
        agreement=torch.full((count,), 0.6),
        mass=torch.bincount(owners.flatten() + 1, minlength=count + 1)[1:].float(),
    )
    return field


def splat(means: Tensor, scale: float, colors: Tensor, opacity: float = 0.98) -> Gaussians:
    """Round opaque Gaussians of one size."""
    return replace(gaussians_at(means, scale, opacity), sh=((colors - 0.5) / SH_C0)[:, None])


def coded(
    gaussians: Gaussians,
    main: Tensor,
    generator: torch.Generator,
    cameras: Cameras,
    k: int = 4,
    n_others: int = 10,
) -> LanguageField:
    """A field whose Gaussians mostly mean one atom each, and a little of others.

    ``main`` [N, S] are places in ``THINGS`` and then ``GROUPS``; codes have ``k`` atoms, ``n_others`` are of no thing.
    """
    names = [*THINGS, *GROUPS]
    others = unit(torch.randn(n_others, DIM, generator=generator))
    atoms = torch.cat([torch.stack([table()[name] for name in names]), others])
    count, levels = main.shape
    drawn = torch.randint(len(names), len(atoms), (count, levels, k - 1), generator=generator)
    little = 0.25 * torch.rand(count, levels, k - 1, generator=generator)
    weights = torch.cat([torch.ones(count, levels, 1), little], -1)
    weights /= weights.sum(-1, keepdim=True)
    info = FieldInfo(("s", "m", "l")[:levels], "", gaussians.fingerprint(), count)
    codebook = atoms.expand(levels, -1, -1).clone()
    indices = torch.cat([main[..., None], drawn], -1).to(index_dtype(len(atoms)))
    return LanguageField(indices, weights, codebook, info, gaussians, cameras=cameras)


def views(width: int = 160, height: int = 120) -> Cameras:
    """From the front, the left and the right."""
    eyes = {"front.png": (0.0, -4.0, 0.3), "left.png": (-2.5, -3.2, 0.3), "right.png": (2.5, -3.2, 0.3)}
    return Cameras(
        Camera.look_at(eye, (0.0, 0.0, 0.0), name, width, height, 1.15 * width) for name, eye in eyes.items()
    )


def saved_field(folder: Path) -> Path:
    """The field of things as a file with its geometry, and ``words.npz`` beside it."""
    words = folder / "words.npz"
    WordTable.save(words, list(table()), torch.stack(list(table().values())).numpy())
    field = things_field()
    field.info = replace(field.info, words=words)
    field.save(folder / "things.scoup", embed_geometry=True)
    return folder / "things.scoup"


# ---- The page

PIXELS = """id => {
  const canvas = document.getElementById(id);
  if (canvas?.hidden) return null;
  const { data, width, height } = canvas
    ? canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height)
    : window.scoupViewer.pixels();
  let text = "";
  for (let at = 0; at < data.length; at += 8192) text += String.fromCharCode(...data.slice(at, at + 8192));
  return { width, height, data: btoa(text) };
}"""
SIZE = (720, 300)
"""Of the window; 400 x 300 of it are the picture."""
FRONT = views()[0].resized(400, 300)
"""The camera that the page opens with, in the size of its picture."""


class Visit:
    """A page that is open, the addresses it asked for, and its problems: errors and warnings of its console."""

    def __init__(self, page: Page) -> None:
        self.page = page
        self.problems: list[str] = []
        self.requests: list[str] = []
        page.set_default_timeout(PATIENCE)
        page.on("console", self._said)
        page.on("pageerror", lambda error: self.problems.append(str(error)))
        page.on("request", lambda request: self.requests.append(request.url))

    def _said(self, message: ConsoleMessage) -> None:
        # The browser reads each frame to compose it without a GPU (tests/view/conftest.py).
        if message.type in ("error", "warning") and "GPU stall due to ReadPixels" not in message.text:
            self.problems.append(message.text)

    def ready(self) -> None:
        """Wait until the page can be asked."""
        self.until("Boolean(window.scoupViewer)")
        self.page.evaluate("window.scoupViewer.ready")
        self.settle()

    def until(self, expression: str) -> None:
        """Wait until something is true. The page forbids what playwright's own waiting needs."""
        end = time.monotonic() + PATIENCE / 1000
        while not self.page.evaluate(expression):
            assert time.monotonic() < end, f"never: {expression}"
            self.page.wait_for_timeout(20)

    def settle(self) -> None:
        """Wait until all that was asked for is drawn."""
        self.page.evaluate("window.scoupViewer.render()")

    def ask(self, *texts: str) -> None:
        """Type texts and press Enter; waits for the legend."""
        box = self.page.get_by_label("What do you look for?")
        box.fill(", ".join(texts))
        box.press("Enter")
        for text in texts:
            self.row(text).wait_for()
        self.settle()

    def row(self, text: str) -> Locator:
        """The row of a text in the legend."""
        return self.page.locator("#queries li").filter(has=self.page.get_by_text(text, exact=True))

    def tab(self, name: str) -> None:
        """Show a tab of the panel: Answers, Things or View."""
        self.page.get_by_role("tab", name=name).click()

    def choose(self, name: str) -> None:
        """Choose a mode or a level by its name."""
        self.tab("View" if name == "automatic" or name.endswith(")") else "Answers")
        self.page.get_by_role("radio", name=name, exact=True).check(force=True)
        self.settle()

    def slide(self, name: str, value: float) -> None:
        self.tab("View")
        self.page.get_by_role("slider", name=name, exact=True).fill(str(value))
        self.settle()

    def tick(self, name: str, on: bool = True) -> None:
        """Tick a box of the tab View, or not."""
        self.tab("View")
        self.page.get_by_label(name).set_checked(on)
        self.settle()

    def show_exact(self) -> None:
        """Have the server's picture over the page's own."""
        self.tab("View")
        self.page.get_by_role("button", name="Exact picture").click()
        self.page.locator("#badge", has_text="rendered codes").wait_for()

    def remove(self, text: str) -> None:
        self.tab("Answers")
        self.page.get_by_role("button", name=f"Remove {text}").click()
        self.settle()

    def saved(self, button: str, folder: Path) -> Path:
        """The file that a button of the answers or of the card saves."""
        with self.page.expect_download() as download:
            self.page.get_by_role("button", name=button, exact=button == "Save").click()
        path = folder / download.value.suggested_filename
        download.value.save_as(path)
        return path

    def state(self) -> dict[str, Any]:
        """What is on the screen."""
        return self.page.evaluate("window.scoupViewer.state()")

    def picture(self) -> Picture:
        """What is seen of the scene, [H, W, 3]."""
        return np.asarray(self.pixels())[..., :3]

    def pixels(self, canvas: str = "") -> Picture | None:
        """[H, W, 4] of the scene, or of a canvas over it; None where that is hidden."""
        found = self.page.evaluate(PIXELS, canvas)
        if found is None:
            return None
        rows = np.frombuffer(base64.b64decode(found["data"]), np.uint8)
        return rows.reshape(found["height"], found["width"], 4)

    def at(self, place: tuple[float, float]) -> tuple[float, float]:
        """The point of the window at a share of the picture's width and height."""
        box = self.page.locator("#canvas").bounding_box()
        assert box is not None
        return box["x"] + place[0] * box["width"], box["y"] + place[1] * box["height"]

    def click(self, place: tuple[float, float]) -> str:
        """Click into the picture, at a share of its width and height; what the page says is there."""
        self.page.evaluate("document.getElementById('place').hidden = true")  # what an earlier click found
        self.page.mouse.click(*self.at(place))
        panel = self.page.locator("#place")
        panel.wait_for()
        return panel.inner_text()


@contextmanager
def visiting(
    browser: Browser, address: str, size: tuple[int, int] = SIZE, offline: bool = False, **options: Any
) -> Iterator[Visit]:
    """A visitor of its own at an address; what went wrong, and any request to elsewhere, is a failure.

    ``offline`` is without a network; other options are of the browser's context.
    """
    context = browser.new_context(**options) if options else browser.contexts[0]
    context.set_offline(offline)
    page = context.new_page()
    try:
        page.set_viewport_size({"width": size[0], "height": size[1]})
        visit = Visit(page)
        page.goto(address)
        visit.ready()
        yield visit
        own = urlsplit(address)
        for asked in map(urlsplit, visit.requests):
            assert asked.scheme in ("data", "blob") or asked[:2] == own[:2], asked.geturl()
        assert visit.problems == []
    finally:
        context.close() if options else page.close()


def places_in(camera: Camera | None = None) -> dict[str, tuple[float, float]]:
    """Where the middle of each thing is seen, in shares of width and height; by default where the page opens."""
    camera, found = camera or views()[0], {}
    for name, (place, _) in THINGS.items():
        point = torch.tensor([*place, 1.0], dtype=torch.float64)
        x, y, depth = (camera.K @ (camera.viewmat @ point)[:3]).tolist()
        found[name] = (x / depth / camera.width, y / depth / camera.height)
    return found


def patches(picture: Picture) -> dict[str, NDArray[np.float64]]:
    """The pixels in the middle of each thing, [P, 3]."""
    (height, width), found = picture.shape[:2], {}
    for name, (x, y) in places_in().items():
        row, column = round(y * height), round(x * width)
        cut = picture[row - 4 : row + 5, column - 4 : column + 5]
        found[name] = cut.reshape(-1, 3).astype(np.float64)
    return found


def check_saved(path: Path, wanted: Gaussians) -> None:
    """Compare a file that the page saved, in whatever order, with its Gaussians."""
    found = load_gaussians(path)
    order = torch.cdist(wanted.means.double(), found.means.double()).argmin(1)
    assert order.sort().values.equal(torch.arange(len(found)))
    tolerances = {"means": (1e-5, 0), "opacities": (3e-3, 0), "scales": (0, 0.02), "sh": (8e-3, 0)}
    for name, (atol, rtol) in tolerances.items():
        saved, given = getattr(found, name)[order], getattr(wanted, name)
        torch.testing.assert_close(saved, given, atol=atol, rtol=rtol)


def render(viewed: ViewedField, mask: Tensor | None = None, camera: Camera | None = None) -> Picture:
    """The picture of some of the Gaussians by our own rasteriser, by default from where the page opens."""
    gaussians = viewed.gaussians if mask is None else viewed.gaussians.select(mask)
    return as_picture(raster.render_colors(gaussians, camera or FRONT))


ABSENT_TOO = "show texts that are not in the scene, too"
AUTOMATIC = "automatic, for each text"
LEVELS = {None: "automatic", 0: "s (fine)", 1: "m (medium)", 2: "l (coarse)"}
both_pages = pytest.mark.parametrize("visit", ["live", "exported"], indirect=True)
"""In every run; other tests visit the exported page in `make test-all` only: it shares all code but that of answers."""
ALIKE = 0.06
"""Two pictures that differ by less show the same: what is left are the rounding of colours, scales and edges."""


def difference(picture: Picture, wanted: Picture) -> float:
    """How far a picture is from the one that is wanted, as a share of all its light: root mean squares."""
    return float(np.linalg.norm(picture.astype(float) - wanted) / np.linalg.norm(wanted.astype(float)))


DRAWS = """() => {
  window.draws = [];
  const own = WebGL2RenderingContext.prototype.drawElementsInstanced;
  WebGL2RenderingContext.prototype.drawElementsInstanced = function (...values) {
    window.draws.push((values[1] * values[4]) / 6);
    return own.apply(this, values);
  };
}"""
"""Notes how many Gaussians each frame draws."""
CONTRASTS = Path(__file__).with_name("contrasts.js").read_text()


def opened(viewed: ViewedField, **options: Any) -> Viewer:
    """A viewer at any port."""
    from scoup.view.viewer import Viewer

    return Viewer(viewed, **{"port": 0, **options})


@contextmanager
def served(browser: Browser, viewed: ViewedField, **options: Any) -> Iterator[Visit]:
    """A visitor of a viewer of its own."""
    with opened(viewed, **options) as viewer, visiting(browser, viewer.address) as visit:
        yield visit
