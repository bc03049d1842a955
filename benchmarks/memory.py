"""The memory of a process."""

from __future__ import annotations

from pathlib import Path


def memory_of(process: int) -> dict[str, int]:
    """Return a process's own memory now (RssAnon) and its most resident memory (VmHWM), bytes; {} if unknown."""
    try:
        lines = Path(f"/proc/{process}/status").read_text().splitlines()
    except OSError:
        return {}
    fields = dict(line.split(":", 1) for line in lines if line.startswith(("RssAnon", "VmHWM")))
    return {name: int(value.split()[0]) * 1024 for name, value in fields.items()}
