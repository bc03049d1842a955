"""Files of ours in the safetensors format: arrays, and a JSON header with checksums of itself and of every array."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from scoup.base.errors import FileFormatError, ScoupError
from scoup.base.inputs import existing_file
from scoup.base.outputs import atomic_file

if TYPE_CHECKING:
    from numpy.typing import NDArray

KEY = "scoup"  # of the header, in the metadata
NO_CHECKSUM = "0" * 8


@dataclass(frozen=True, eq=False)
class SealedFile:
    """A file that is read."""

    path: Path
    stream: Any
    """Of safetensors."""
    text: str
    """The header, "{}" in files of others."""
    remedy: str
    """Of damage."""

    @classmethod
    @contextmanager
    def open(
        cls, path: Path, what: str, remedy: str, other: str = "", framework: Literal["numpy", "pt"] = "numpy"
    ) -> Iterator[SealedFile]:
        """Open a file; every failure of reading it in the block becomes a FileFormatError.

        ``other`` is the remedy for a file of another format, "" if that counts as damage. Tensors of the framework "pt"
        are mapped, and stay so when the file is closed; arrays of "numpy" are read.
        """
        from safetensors import safe_open

        existing_file(path, what)
        with _damage_named(path, what, remedy):
            if other:
                with path.open("rb") as start:
                    if start.read(9)[8:] != b"{":  # of the header of any safetensors file
                        raise FileFormatError(path, f"is not {what}", other)
            with safe_open(path, framework=framework) as stream:
                yield cls(path, stream, (stream.metadata() or {}).get(KEY, "{}"), remedy)

    @staticmethod
    def write(
        path: Path,
        header: Mapping[str, Any],
        arrays: Mapping[str, NDArray[Any]],
        overwrite: bool = False,
        flush: bool = True,
        wait: bool = False,
    ) -> int:
        """Write a file whole; return its size. Further arguments and errors as of ``atomic_file``.

        Writers of safetensors would copy all arrays, and hide the number of the system's errors.
        """
        checksums = {name: array_checksum(array) for name, array in arrays.items()}
        layout: dict[str, Any] = {"__metadata__": {KEY: sealed({**header, "checksums": checksums})}}
        # Larger items first, as in the library: then each array begins at a multiple of its item size.
        names = sorted(arrays, key=lambda name: (-arrays[name].dtype.itemsize, name))
        end = 0
        for name in names:
            kind, first, end = arrays[name].dtype, end, end + arrays[name].nbytes
            layout[name] = {
                "dtype": f"{kind.kind.upper()}{8 * kind.itemsize}",
                "shape": list(arrays[name].shape),
                "data_offsets": [first, end],
            }
        head = json.dumps(layout, separators=(",", ":")).encode()
        head += b" " * (-len(head) % 8)
        with atomic_file(path, overwrite, flush, wait) as stream:
            stream.write(len(head).to_bytes(8, "little") + head)
            for name in names:
                stream.write(_bytes_of(arrays[name]))
        return 8 + len(head) + end

    def check(self, header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Compare the header and all arrays of the file with their checksums."""
        self.check_header(header["checksum"])
        if header["checksums"].keys() != arrays.keys():
            raise FileFormatError(self.path, "is damaged (its header names other tensors)", self.remedy)
        for name, array in arrays.items():
            self.check_array(name, array, header["checksums"][name])

    def check_header(self, checksum: object) -> None:
        if not (
            isinstance(checksum, str) and _crc32(_replaced(self.text, checksum, NO_CHECKSUM)) == checksum
        ):
            raise FileFormatError(self.path, "is damaged (checksum of the header)", self.remedy)

    def check_array(self, name: str, array: NDArray[Any], checksum: object) -> None:
        if array_checksum(array) != checksum:
            raise FileFormatError(self.path, f"is damaged (checksum of {name})", self.remedy)


def array_checksum(array: NDArray[Any]) -> str:
    """Return the CRC-32, the fastest checksum of the standard library, over type, shape and bytes of an array, as eight
    hexadecimal digits."""
    described = f"{array.dtype} {list(array.shape)}\n".encode()
    return f"{zlib.crc32(_bytes_of(array), zlib.crc32(described)):08x}"


def _bytes_of(array: NDArray[Any]) -> memoryview:
    import numpy as np

    return np.ascontiguousarray(array).reshape(-1).view(np.uint8).data


def sealed(header: Mapping[str, Any]) -> str:
    """Return a header as JSON, with a checksum of this very text, taken with zeros in the checksum's place."""
    text = json.dumps({**header, "checksum": NO_CHECKSUM}, sort_keys=True)
    return _replaced(text, NO_CHECKSUM, _crc32(text))


def _crc32(text: str) -> str:
    return f"{zlib.crc32(text.encode()):08x}"


def _replaced(text: str, checksum: str, other: str) -> str:
    return text.replace(f'"checksum": "{checksum}"', f'"checksum": "{other}"', 1)


@contextmanager
def _damage_named(path: Path, what: str, remedy: str) -> Iterator[None]:
    """Turn every failure of reading a damaged safetensors file into a FileFormatError."""
    from safetensors import SafetensorError

    try:
        yield
    except ScoupError:
        raise
    except OSError as error:
        raise FileFormatError.unreadable(path, error) from error
    except (SafetensorError, ValueError, KeyError, TypeError, RuntimeError, OverflowError) as error:
        words = [] if isinstance(error, SafetensorError) else str(error).splitlines()  # not the library's
        reason = f" ({words[0]})" if words else ""
        raise FileFormatError(path, f"is not {what} or is damaged{reason}", remedy) from error
