"""Bars of a document as one SVG file, light or dark as the reader's system is."""

from __future__ import annotations

from html import escape

WIDTH, LEFT, RIGHT, ROW, TOP = 720, 230, 70, 34, 44
STYLE = """
  text { font: 15px system-ui, sans-serif; fill: #1f2328; }
  .title { font-weight: 600; }
  rect { fill: #0a5cad; }
  .ground { fill: #ffffff; }
  @media (prefers-color-scheme: dark) { text { fill: #e6edf3; } rect { fill: #58a6ff; } .ground { fill: #0d1117; } }
"""


def bars(title: str, rows: dict[str, float], unit: str) -> str:
    """Return a chart of one horizontal bar per row, with its value, as the text of an SVG file."""
    most = max(rows.values())
    lines = [
        '<rect class="ground" width="100%" height="100%"/>',
        f'<text class="title" x="0" y="20">{escape(title)}</text>',
    ]
    for number, (name, value) in enumerate(rows.items()):
        y = TOP + number * ROW
        length = max(2.0, value / most * (WIDTH - LEFT - RIGHT))
        lines += [
            f'<text x="{LEFT - 12}" y="{y + 17}" text-anchor="end">{escape(name)}</text>',
            f'<rect x="{LEFT}" y="{y}" width="{length:.1f}" height="22" rx="3"/>',
            f'<text x="{LEFT + length + 8:.1f}" y="{y + 17}">{value:.0f} {unit}</text>',
        ]
    height = TOP + len(rows) * ROW
    values = ", ".join(f"{name} {value:.0f} {unit}" for name, value in rows.items())
    size = f'viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size} role="img">'
    about = f"<title>{escape(title)}: {escape(values)}</title>"
    return "\n".join([head, about, f"<style>{STYLE}</style>", *lines, "</svg>\n"])
