"""Text out of files, as terminals and pages may show it."""

from __future__ import annotations

_CONTROLS = (*range(32), *range(127, 160), 0x2028, 0x2029, *range(0x202A, 0x202F), *range(0x2066, 0x206A))
_ESCAPES = {
    code: f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}"
    for code in _CONTROLS
    if chr(code) not in "\n\t"
}


def printable(text: str) -> str:
    """Return the text with control characters escaped, but for line feeds and tabs.

    Names out of files may hold them. They could move the cursor of a terminal, or reverse the order of letters.
    """
    return text.translate(_ESCAPES)
