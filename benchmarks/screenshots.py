"""Pictures of the viewer's page for the documents: dark, dark at the width of a phone, and a moving one.

    python -m benchmarks.screenshots FIELD TEXT [TEXT ...] [--camera NAME] [--mode MODE] [--out FOLDER]

Opens a field in the viewer and its page in headless Chromium, asks the texts, and writes viewer-dark.jpg
and viewer-dark-phone.jpg; with --moving, viewer.webp instead, in which the texts are typed one after
another, and its last picture, viewer.jpg. Needs Chromium, playwright and the page (tools/build_viewer.py).
"""

from __future__ import annotations

import argparse
import io
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

import scoup
from benchmarks.chromium import chromium, program
from scoup.view import ViewedField, Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PICTURES: dict[str, dict[str, Any]] = {
    "viewer-dark": {"viewport": {"width": 1120, "height": 640}, "color_scheme": "dark"},
    "viewer-dark-phone": {
        "viewport": {"width": 390, "height": 780},
        "color_scheme": "dark",
        "has_touch": True,
        "is_mobile": True,
    },
}
MOVING: dict[str, Any] = {"viewport": {"width": 960, "height": 540}, "color_scheme": "light"}
TYPED, ANSWERED, LAST = 90, 2200, 3500
"""Milliseconds that a picture is shown: while a text is typed, when it is answered, and at the end."""
PATIENCE = 300_000
"""Milliseconds: drawing without a GPU takes seconds a frame."""
QUALITY = 88
IN_SIGHT_IS_LOADED = (
    "[...document.images].every((each) => each.complete || !each.offsetParent || "
    "each.getBoundingClientRect().top > innerHeight)"
)


@contextmanager
def opened(browser: Browser, address: str, camera: str | None, look: dict[str, Any]) -> Iterator[Page]:
    """The page in a window of the given size and colours, seen from a camera of the field."""
    context = browser.new_context(reduced_motion="reduce", **look)
    try:
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(address)
        page.wait_for_selector("#loading", state="hidden")
        if camera is not None:
            page.evaluate("name => window.scoupViewer.flyTo(name)", camera)
        yield page
    finally:
        context.close()


def take(browser: Browser, address: str, options: argparse.Namespace, look: dict[str, Any]) -> Image.Image:
    """Return a picture of the page in a window of a size and colours after all texts were asked at once."""
    with opened(browser, address, options.camera, look) as page:
        box = page.get_by_label("What do you look for?")
        box.fill(", ".join(options.texts))
        box.press("Enter")
        for text in options.texts:
            page.locator("#queries li").filter(has_text=text).first.wait_for()
        if options.mode is not None:
            page.evaluate("mode => window.scoupViewer.set({ mode })", options.mode)
        box.fill("")
        page.evaluate("document.activeElement.blur()")
        _settle(page)
        return _picture(page)


def film(browser: Browser, address: str, options: argparse.Namespace) -> tuple[list[Image.Image], list[int]]:
    """Return pictures of the page while each text is typed and answered, and the milliseconds to show each."""
    pictures, milliseconds = [], []
    with opened(browser, address, options.camera, MOVING) as page:
        box = page.get_by_label("What do you look for?")
        _settle(page)
        for text in options.texts:
            for end in range(len(text) + 1):
                box.fill(text[:end])
                pictures.append(_picture(page))
                milliseconds.append(TYPED)
            box.press("Enter")
            page.locator("#queries li").filter(has_text=text).first.wait_for()
            if options.mode is not None:
                page.evaluate("mode => window.scoupViewer.set({ mode })", options.mode)
            _settle(page)
            pictures.append(_picture(page))
            milliseconds.append(ANSWERED)
    milliseconds[-1] = LAST
    return pictures, milliseconds


def _picture(page: Page) -> Image.Image:
    return Image.open(io.BytesIO(page.screenshot())).convert("RGB")


def _settle(page: Page) -> None:
    """Wait until all Gaussians are drawn, and the small pictures of the cameras in sight; others are not fetched."""
    page.evaluate("window.scoupViewer.whole")
    page.evaluate("window.scoupViewer.render()")
    page.wait_for_function(IN_SIGHT_IS_LOADED)
    page.wait_for_timeout(500)


def main(arguments: list[str] | None = None) -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("field", type=Path, help="the .scoup file")
    parser.add_argument("texts", nargs="+", help="what to look for")
    parser.add_argument("--camera", help="of the field; by default its first")
    parser.add_argument("--mode", help="colour, heat, only, except, codes or confidence")
    parser.add_argument("--moving", action="store_true", help="one moving picture")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder")
    options = parser.parse_args(arguments)
    if program() is None:
        print("there is no Chromium here; install chromium", file=sys.stderr)
        return 2
    viewed = ViewedField(scoup.LanguageField.load(options.field))
    options.out.mkdir(parents=True, exist_ok=True)
    with Viewer(viewed, port=0) as viewer, chromium() as browser:
        if options.moving:
            pictures, milliseconds = film(browser, viewer.address, options)
            path = options.out / "viewer.webp"
            first, *rest = pictures
            first.save(
                path, save_all=True, append_images=rest, duration=milliseconds, loop=0, quality=80, method=6
            )
            print(f"{path}: {path.stat().st_size / 1000:.0f} kB")
            stills = {"viewer": pictures[-1]}
        else:
            stills = {name: take(browser, viewer.address, options, look) for name, look in PICTURES.items()}
        for name, picture in stills.items():
            path = options.out / f"{name}.jpg"
            picture.save(path, quality=QUALITY, subsampling=0, optimize=True)
            print(f"{path}: {path.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
