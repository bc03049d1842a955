"""Pages that verbs write, and cards that notebooks show of an object: a title, a picture, and a few facts."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scoup.base.printable import printable

PREVIEW = (320, 240)
"""Width and height of a picture in a card, in pixels."""
_STYLE = """body{font:14px/1.4 system-ui,sans-serif;margin:1.5rem;color-scheme:light dark}
input,select{font:inherit;padding:.4rem .6rem}input{width:min(26rem,100%)}summary{margin:1rem 0;cursor:pointer}
ul{display:grid;grid-template-columns:repeat(auto-fill,minmax(14rem,1fr));gap:1rem;list-style:none;padding:0}
li{border:1px solid #8886;border-radius:.5rem;padding:.6rem}img{width:100%;height:11rem;object-fit:contain}
td,th{padding:.2rem .6rem;text-align:left}b{font-size:1.05rem}small,figcaption{opacity:.75}[hidden]{display:none}
.pairs{grid-template-columns:repeat(auto-fill,minmax(24rem,1fr))}.pairs div{display:grid;grid-template-columns:1fr 1fr}
figure{margin:0;text-align:center}"""


def shown(text: str) -> str:
    """Return a text of a file or user as HTML."""
    return html.escape(printable(text))


def page(title: str, body: str) -> str:
    """Return a page: its title as text, and the HTML below it, in which each `li` of an `ul` is a card."""
    heading = shown(title)
    return (
        f'<!doctype html><html lang="en"><meta charset="utf-8"><title>{heading}</title>\n'
        f'<meta name="viewport" content="width=device-width,initial-scale=1"><style>{_STYLE}</style>\n'
        f"<h1>{heading}</h1>\n{body}\n"
    )


def card(title: str, facts: Mapping[str, Any], picture: NDArray[np.uint8] | None = None) -> str:
    """Return the HTML of a card: the title above, facts by name (both as text), and beside them a picture [H, W, 3]."""
    rows = "".join(
        f'<tr><td style="text-align:left;opacity:.7">{html.escape(name)}</td>'
        f'<td style="text-align:left">{html.escape(str(value))}</td></tr>'
        for name, value in facts.items()
    )
    image = "" if picture is None else f'<img alt="{html.escape(title)}" src="{data_address(picture)}"/>'
    return (
        f'<div><b>{html.escape(title)}</b><div style="display:flex;gap:1em;align-items:flex-start">'
        f"{image}<table>{rows}</table></div></div>"
    )


def data_address(picture: NDArray[np.uint8]) -> str:
    """Return a picture [H, W, 3] uint8 as the address of an image in a page, PNG inside."""
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(picture).save(stream, "PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()
