"""Arguments of public functions: one of a wrong type is named, before it fails somewhere deep."""

from __future__ import annotations

import os
from typing import Any

from scoup.base.errors import InputError

PATH = (str, os.PathLike)
"""What counts as a path."""

_MADE_BY = {
    "Gaussians": "scoup.load_gaussians(path)",
    "Cameras": "scoup.load_cameras(path)",
    "Camera": "scoup.load_cameras(path)[0], or [NAME]",
    "Regions": "scoup.load_regions(folder, cameras)",
    "Field": "scoup.LanguageField.load(path), or scoup.build",
    "RegionSums": "scoup.region_sums(gaussians, cameras, regions)",
    "TextEncoder": "scoup.TextEncoder.open(model_or_table)",
}
"""Type -> what gives one."""


def check_arguments(function: str, **arguments: tuple[Any, type | tuple[type, ...]]) -> None:
    """Refuse arguments of wrong types, in their order: name -> value and the type, or types, expected. ``function`` is
    the name for the message."""
    for name, (value, expected) in arguments.items():
        if isinstance(value, expected):
            continue
        types = expected if isinstance(expected, tuple) else (expected,)
        wanted = "a path" if expected == PATH else types[0].__name__
        remedy = f"; get one from {_MADE_BY[wanted]}" if wanted in _MADE_BY else ""
        order = f" (the order is {', '.join(arguments)})" if len(arguments) > 1 else ""
        raise InputError(
            f"{function}: the argument {name} is of type {type(value).__name__}, expected {wanted}{order}{remedy}"
        )
