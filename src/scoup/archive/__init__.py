"""Many fields as one folder of Parquet files and a matrix, searched together.

Names are loaded when first used: scans are listed without torch.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from scoup.base import lazy_names

_HOMES = {
    "Archive": "scoup.archive.archive",
    "archive_tool": "scoup.archive.agent_tool",
    "list_scans": "scoup.archive.scan_header",
    "results_page": "scoup.archive.page",
}

__all__ = [*_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from scoup.archive.agent_tool import archive_tool as archive_tool
    from scoup.archive.archive import Archive as Archive
    from scoup.archive.page import results_page as results_page
    from scoup.archive.scan_header import list_scans as list_scans

__getattr__ = lazy_names(__name__, _HOMES)
