"""Many fields as one folder of Parquet files and a matrix, searched together."""

from scoup.archive.agent_tool import archive_tool
from scoup.archive.archive import Archive
from scoup.archive.page import results_page

__all__ = [
    "Archive",
    "archive_tool",
    "results_page",
]
