"""Cards that notebooks show of an object: a title, a picture, and a few facts."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

PREVIEW = (320, 240)
"""Width and height of a picture in a card, in pixels."""


def card(title: str, facts: Mapping[str, Any], picture: NDArray[np.uint8] | None = None) -> str:
    """Return the HTML of a card.

    Args:
        title: above.
        facts: what is said of the object, by name; both are shown as text.
        picture: [H, W, 3] uint8, beside the facts.
    """
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
