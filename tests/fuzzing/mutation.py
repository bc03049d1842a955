"""Damage: bytes in, other bytes out; the same for the same random numbers."""

from __future__ import annotations

import json
import re
import struct
from collections.abc import Callable
from copy import deepcopy
from random import Random
from typing import Any

import numpy as np

LONGEST = 1 << 19  # bytes that damage may add to a file
_WHOLE = (0, 1, -1, 2, 7, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
_WIDE = (*_WHOLE, 10**12, 2**40, 2**48, 2**53, 2**62, 2**63 - 1, 2**63, 2**64 - 1, -(2**63))
_FLOATS = tuple(map(float, ("nan", "inf", "-inf", "1e308", "-1e308", "1e-320", "-0.0", "3.5e38", "1e18")))
_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_NUMBERS = [b"-1", b"0", b"nan", b"inf", b"-inf", b"1e400", b"1e308", b"-1e308", b"1e-400", b"0.5", b"4294967296",
            b"2147483648", b"9223372036854775808", b"18446744073709551615", b"99999999999999999999", b"9" * 5000,
            b"0x10", b"1_000", b"true", b"null", b"", b"--1", b"1e", b"\xef\xbc\x91", b"[]", b'"1"']  # fmt: skip
_WORDS = [b"\0", b"\xff", b"\n", b"\r\n", b'"', b"'", b"\\", b"{", b"}", b"[", b"]", b",", b":", b" ", b"\xef\xbb\xbf",
          b"\xed\xa0\x80", b"../../", b"/", b"#", b"null", b"{}", b"[]", b"\x1b[2J", b"\xe2\x80\xa8"]  # fmt: skip
_VALUES: list[Any] = [None, True, False, "", "x", "nan", "..", "../../x", "\0", "\ud800", "é" * 300, [], {}, [[]],
                      [None], {"": {}}, [0] * 1000, 0.5, *_WIDE, 10**30, *_FLOATS]  # fmt: skip


def damage(random: Random, data: bytes) -> bytes:
    """Return the data, damaged at one to four places or cut short."""
    if random.random() < 0.1:
        return data[: random.randrange(len(data) + 1)]
    result = data
    textual = _is_text(data)
    for _ in range(random.choice((1, 1, 1, 2, 2, 3, 4))):
        ways = _OF_TEXT if textual and random.random() < 0.6 else _OF_BYTES
        result = random.choice(ways)(random, result)
    return result[: 4 * len(data) + LONGEST]


def _place(random: Random, data: bytes) -> int:
    """Return a byte of the data: half of the time one of the first, where headers are."""
    near = min(len(data), random.choice((16, 64, 256, 1024)))
    return random.randrange((near if random.random() < 0.5 else len(data)) + 1)


def _length(random: Random) -> int:
    return random.choice((1, 2, 4, 8, random.randrange(1, 64), random.randrange(1, 4096)))


def _flip(random: Random, data: bytes) -> bytes:
    result = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 8, 32))):
        if result:
            result[min(_place(random, data), len(result) - 1)] ^= 1 << random.randrange(8)
    return bytes(result)


def _number(random: Random, data: bytes) -> bytes:
    """Return a number of one to eight bytes in the place of whatever is there, often at a multiple of its width."""
    kind = random.choice("bhiiqqfd")
    order = random.choice("<<<>")
    if kind in "fd":
        with np.errstate(over="ignore"):
            packed = np.array(random.choice(_FLOATS)).astype(order + kind).tobytes()
    else:
        width = struct.calcsize(kind)
        whole = random.choice(_WIDE) & (1 << 8 * width) - 1
        packed = whole.to_bytes(width, "little" if order == "<" else "big")
    place = _place(random, data)
    if random.random() < 0.7:
        place -= place % len(packed)
    return data[:place] + packed + data[place + len(packed) :]


def _replace(random: Random, data: bytes) -> bytes:
    """Return the data with a piece inserted or in place of another: bytes of one value, random, or of the data."""
    place, size, source = _place(random, data), _length(random), _place(random, data)
    pieces = (b"", bytes(size), b"\xff" * size, random.randbytes(size), data[source : source + size])
    piece = (random.choice(pieces) * random.choice((1, 1, 2, 100)))[:LONGEST]
    return data[:place] + piece + data[place + random.choice((0, len(piece), _length(random))) :]


def _other_number(random: Random, data: bytes) -> bytes:
    found = list(_NUMBER.finditer(data[: 1 << 16]))
    if not found:
        return _word(random, data)
    result = data
    for hit in sorted(
        random.sample(found, min(len(found), random.choice((1, 1, 2)))), key=lambda h: -h.start()
    ):
        result = result[: hit.start()] + random.choice(_NUMBERS) + result[hit.end() :]
    return result


def _word(random: Random, data: bytes) -> bytes:
    place = _place(random, data)
    return data[:place] + random.choice(_WORDS) + data[place + random.choice((0, 0, 1, 3)) :]


def _deep(random: Random, data: bytes) -> bytes:
    """Insert nested brackets, closed or not."""
    depth = random.choice((10, 150, 999, 5000, 100_000))
    opened, closed = random.choice(((b"[", b"]"), (b'{"a":', b"}"), (b"(", b")"), (b"-", b"")))
    place = _place(random, data)
    inside = (opened * depth)[:LONGEST] + random.choice((b"", b"1", b"1" + closed * depth))
    return data[:place] + inside + data[place:]


def _json(random: Random, data: bytes) -> bytes:
    """Return one value of JSON exchanged, removed or repeated; the text stays JSON."""
    try:
        root = json.loads(data)
    except (ValueError, RecursionError):
        return _other_number(random, data)
    for _ in range(random.choice((1, 1, 2, 4))):
        root = _changed(random, root)
    try:
        return json.dumps(root).encode()
    except RecursionError:
        return data


def _changed(random: Random, value: Any) -> Any:
    inner = isinstance(value, (dict, list)) and len(value) > 0
    if inner and random.random() < 0.8:
        keys = list(value) if isinstance(value, dict) else list(range(len(value)))
        key = random.choice(keys)
        match random.randrange(12):
            case 0:
                del value[key]
            case 1 if isinstance(value, list):
                value[key:key] = [value[key]] * random.choice((1, 2, 1000))
            case 1 | 2:
                value[key] = deepcopy(value[random.choice(keys)])
            case _:
                value[key] = _changed(random, value[key])
        return value
    if isinstance(value, (int, float)) and random.random() < 0.7:
        return random.choice((*_WIDE, *_FLOATS, value + 1, value - 1, -value, value * 1000))
    return deepcopy(random.choice((*_VALUES, [value], {"x": value}, str(value)[:100], [value] * 100)))


def _is_text(data: bytes) -> bool:
    start = data[:200]
    return bool(start) and sum(32 <= byte < 127 or byte in (9, 10, 13) for byte in start) > 0.95 * len(start)


Way = Callable[[Random, bytes], bytes]
_OF_BYTES: tuple[Way, ...] = (_flip, _number, _replace)
_OF_TEXT: tuple[Way, ...] = (_other_number, _other_number, _word, _deep, _json, _json, _json)
