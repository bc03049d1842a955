"""Failures of reading damaged safetensors files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from scoup.base.errors import FileFormatError, ScoupError, refused_read


@contextmanager
def safetensors_damage_named(path: Path, what: str, remedy: str) -> Iterator[None]:
    """Turn every failure of reading a damaged safetensors file into a FileFormatError."""
    from safetensors import SafetensorError

    try:
        yield
    except ScoupError:
        raise
    except FileNotFoundError as error:
        raise refused_read(path, error) from error
    except (
        SafetensorError,
        ValueError,
        KeyError,
        TypeError,
        OSError,
        RuntimeError,
        OverflowError,
        RecursionError,
    ) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise FileFormatError(path, f"is not {what} or is damaged ({reason})", remedy) from error
