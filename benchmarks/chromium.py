"""A headless Chromium of the system, driven by playwright: for tests, figures and pictures of the viewer's page."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
# SwiftShader draws without a GPU; the rest keeps the browser from asking the network for anything of its own.
FLAGS = (
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
    "--disable-quic",
)

COUNTER = """(() => {
  const state = (window.drawing = { frames: 0, drawn: false, most: 0, context: null });
  for (const [name, counts] of [["drawElementsInstanced", [1, 4]], ["drawArraysInstanced", [2, 3]]]) {
    const own = WebGL2RenderingContext.prototype[name];
    WebGL2RenderingContext.prototype[name] = function (...values) {
      state.context = this;
      state.drawn = true;
      state.most = Math.max(state.most, (values[counts[0]] * values[counts[1]]) / 6);
      return own.apply(this, values);
    };
  }
  state.finish = () => {
    const gl = state.context;
    if (!gl) return;
    const bound = gl.getParameter(gl.PIXEL_PACK_BUFFER_BINDING); // a page may be reading into it
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, bound);
  };
  const tick = () => {
    if (state.drawn) state.frames += 1;
    state.drawn = false;
    requestAnimationFrame(tick);
  };
  requestAnimationFrame(tick);
})()"""
"""To be run before a page's own scripts: counts frames in which something was drawn, and the most quads of one call.
``finish`` waits until all is drawn."""
DRAG, STEPS = 60, 15  # pixels to either side, and moves on the way
DRAG_SECONDS = 15.0


def program() -> str | None:
    """The path of a Chromium, if there is one."""
    return next((found for found in map(shutil.which, NAMES) if found), None)


@contextmanager
def chromium() -> Iterator[Browser]:
    """A browser without a window."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program(), args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()


def seconds_until_drawn(page: Page, count: float, patience: float) -> float:
    """Return the seconds from the start of navigation until a page with ``COUNTER`` has drawn so many quads."""
    end = time.monotonic() + patience
    while page.evaluate("drawing.most") < count:
        if time.monotonic() > end:
            raise SystemExit(f"{page.url} drew {page.evaluate('drawing.most')} of {count} Gaussians")
        page.wait_for_timeout(20)
    return page.evaluate("(drawing.finish(), performance.now() / 1000)")


def drag(page: Page, place: tuple[int, int]) -> tuple[int, float]:
    """Drag the pointer back and forth around a place of a page with ``COUNTER``; return frames and seconds."""
    x, y = place
    page.mouse.move(x, y)
    before, started, step = page.evaluate("(drawing.finish(), drawing.frames)"), time.monotonic(), 0
    page.mouse.down()
    while time.monotonic() - started < DRAG_SECONDS:
        step += 1
        page.mouse.move(x + DRAG * math.sin(step * math.pi / STEPS), y)
    frames = page.evaluate("(drawing.finish(), drawing.frames)") - before
    seconds = time.monotonic() - started
    page.mouse.up()
    return frames, seconds
