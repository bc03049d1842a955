"""Pages that verbs write, and cards that notebooks show of an object: templates of jinja2, whose values are text."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from scoup.base.texts import printable

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PREVIEW = (320, 240)
"""Width and height of a picture in a card, in pixels."""
_PAGE = """<!doctype html><html lang="en"><meta charset="utf-8"><title>{{ title }}</title>
<meta name="viewport" content="width=device-width,initial-scale=1"><style>
body{font:14px/1.4 system-ui,sans-serif;margin:1.5rem;color-scheme:light dark}
input,select{font:inherit;padding:.4rem .6rem}input{width:min(26rem,100%)}summary{margin:1rem 0;cursor:pointer}
ul{display:grid;grid-template-columns:repeat(auto-fill,minmax(14rem,1fr));gap:1rem;list-style:none;padding:0}
li{border:1px solid #8886;border-radius:.5rem;padding:.6rem}img{width:100%;height:11rem;object-fit:contain}
td,th{padding:.2rem .6rem;text-align:left}b{font-size:1.05rem}small,figcaption{opacity:.75}[hidden]{display:none}
.pairs{grid-template-columns:repeat(auto-fill,minmax(24rem,1fr))}.pairs div{display:grid;grid-template-columns:1fr 1fr}
figure{margin:0;text-align:center}</style>
<h1>{{ title }}</h1>
{% block body %}{% endblock %}
"""
_CARD = """<div><b>{{ title }}</b><div style="display:flex;gap:1em;align-items:flex-start">
{%- if picture is not none %}<img alt="{{ title }}" src="{{ picture }}"/>{% endif %}<table>
{%- for name, value in facts.items() -%}
<tr><td style="text-align:left;opacity:.7">{{ name }}</td><td style="text-align:left">{{ value }}</td></tr>
{%- endfor %}</table></div></div>"""


def html(template: str, **values: Any) -> str:
    """Return the HTML of a template, in which values are text: markup and control characters are escaped. A picture
    [H, W, 3] uint8 is its address.

    A template that begins with `{% extends "page" %}` fills the block `body` below a `title`; each `li` of an `ul` is a
    card.
    """
    from jinja2 import DictLoader, Environment, StrictUndefined

    environment = Environment(
        autoescape=True,
        trim_blocks=True,
        undefined=StrictUndefined,
        loader=DictLoader({"page": _PAGE}),
        finalize=_shown,
    )
    return environment.from_string(template).render(values)


def _shown(value: Any) -> Any:
    """Return what a page contains for a value of a template; of a picture [H, W, 3] uint8 its address, PNG inside."""
    if getattr(value, "ndim", 0) != 3:
        return printable(value) if isinstance(value, str) else value
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(value).save(stream, "PNG")
    return "data:image/png;base64," + base64.b64encode(stream.getvalue()).decode()


def card(title: str, facts: Mapping[str, Any], picture: NDArray[np.uint8] | None = None) -> str:
    """Return the HTML of a card: the title above, facts by name, and beside them a picture [H, W, 3]."""
    return html(_CARD, title=title, facts=facts, picture=picture)
