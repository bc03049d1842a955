"""Pictures of the viewer's page for the documents: light, dark, and dark at the width of a phone.

    python -m benchmarks.screenshots FIELD TEXT [TEXT ...] [--table WORDS] [--camera NAME] [--mode MODE] [--out FOLDER]

Opens a field in the viewer and its page in headless Chromium, asks the texts, and writes viewer-light.jpg,
viewer-dark.jpg and viewer-dark-phone.jpg. Needs Chromium, playwright and the page (tools/build_viewer.py).
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from PIL import Image

import scoup
from benchmarks.chromium import chromium, program
from scoup.view import ViewedField, Viewer

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

PICTURES: dict[str, dict[str, Any]] = {
    "viewer-light": {"viewport": {"width": 1120, "height": 640}, "color_scheme": "light"},
    "viewer-dark": {"viewport": {"width": 1120, "height": 640}, "color_scheme": "dark"},
    "viewer-dark-phone": {
        "viewport": {"width": 390, "height": 780},
        "color_scheme": "dark",
        "has_touch": True,
        "is_mobile": True,
    },
}
PATIENCE = 300_000
"""Milliseconds: drawing without a GPU takes seconds a frame."""
QUALITY = 88
IN_SIGHT_IS_LOADED = (
    "[...document.images].every((each) => each.complete || !each.offsetParent || "
    "each.getBoundingClientRect().top > innerHeight)"
)


def take(browser: Browser, address: str, options: argparse.Namespace, look: dict[str, Any]) -> bytes:
    """A picture of the page as a visitor sees it, as PNG.

    Args:
        browser: to open it in.
        address: of the page.
        options: texts, camera and mode.
        look: size and colours of the window.
    """
    context = browser.new_context(reduced_motion="reduce", **look)
    try:
        page = context.new_page()
        page.set_default_timeout(PATIENCE)
        page.goto(address)
        page.wait_for_selector("#loading", state="hidden")
        if options.camera is not None:
            page.evaluate("name => window.scoupViewer.flyTo(name)", options.camera)
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
        return page.screenshot()
    finally:
        context.close()


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
    parser.add_argument("--table", help="word table or model, where the field's own is not at hand")
    parser.add_argument("--camera", help="of the field; by default its first")
    parser.add_argument("--mode", help="colour, heat, only, except, codes or confidence")
    parser.add_argument("--out", type=Path, default=Path("docs/images"), help="folder")
    options = parser.parse_args(arguments)
    if program() is None:
        print("there is no Chromium here; install chromium", file=sys.stderr)
        return 2
    viewed = ViewedField(scoup.LanguageField.load(options.field, words=options.table))
    options.out.mkdir(parents=True, exist_ok=True)
    with Viewer(viewed, port=0) as viewer, chromium() as browser:
        for name, look in PICTURES.items():
            picture = Image.open(io.BytesIO(take(browser, viewer.address, options, look))).convert("RGB")
            path = options.out / f"{name}.jpg"
            picture.save(path, quality=QUALITY, subsampling=0, optimize=True)
            print(f"{path}: {path.stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
