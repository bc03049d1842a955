"""Options that verbs share, and how options are shown in the help."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import NoneType
from typing import Annotated, Any, Literal, get_args, get_origin

import tyro

from scoup.base import InputError

CLIP_MODEL = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
"""LangSplat's, which verbs assume where no other is named."""

arg = partial(tyro.conf.arg, help_behavior_hint="")
"""An option shown in the help without its default, which its text gives in words."""

Model = Annotated[str | None, arg(metavar="TABLE|MODEL")]
Names = Annotated[tyro.conf.UseAppendAction[tuple[str, ...]], arg(metavar="NAME")]
Direction = Annotated[tuple[float, float, float] | None, arg(metavar="X Y Z")]
FieldFile = Annotated[tyro.conf.Positional[Path], arg(metavar="FIELD")]
Texts = Annotated[tyro.conf.Positional[tuple[str, ...]], arg(metavar="TEXT [TEXT ...]")]

_METAVARS = {Path: "PATH", str: "TEXT", int: "INT", float: "NUMBER"}


def option_type(kind: Any) -> Any:
    """Return the type of a field of a verb with how the help shows it: switches, and options that are None by default,
    without the default."""
    plain, *settings = get_args(kind) if get_origin(kind) is Annotated else (kind,)
    if plain is bool:
        settings = [arg(), *settings]
    elif NoneType in get_args(plain) and (metavar := _METAVARS.get(get_args(plain)[0])):
        settings = [arg(metavar=metavar), *settings]
    return Annotated[(plain, *settings)] if settings else plain


def check_number(option: str, value: float | None, least: float, most: float = math.inf) -> None:
    """Refuse a number, if one was passed, that is out of the range of its option."""
    if value is not None and not least <= value <= most:
        wanted = f"{least:g} to {most:g}" if most < math.inf else f"{least:g} or more"
        raise InputError(f"{option} must be {wanted}, got {value}")


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options of all verbs."""

    quiet: bool = False
    """Print nothing but warnings and errors."""
    as_json: Annotated[bool, arg(name="json")] = False
    """Print one JSON object on standard output instead of text, for other programs."""


@dataclass(frozen=True, kw_only=True)
class WritesCommon(Common):
    """Options of verbs that write files."""

    overwrite: bool = False
    """Replace existing outputs."""


@dataclass(frozen=True, kw_only=True)
class DeviceCommon(Common):
    """Options of verbs that compute with torch."""

    device: str = "cpu"
    """Device of the tensors: cpu, or cuda if torch has a GPU (experimental, see docs/gpu.md)."""


@dataclass(frozen=True, kw_only=True)
class AllCommon(DeviceCommon, WritesCommon):
    """Options of verbs that compute and write."""


@dataclass(frozen=True, kw_only=True)
class PhotographMasks:
    """Masks of photographs that are cut into regions."""

    masks: Annotated[Literal["white", "black"] | None, arg()] = None
    """Where masks of photographs (docs/own_scene.md) allow regions. Default: white; asked if that seems wrong."""
    no_masks: bool = False
    """Ignore masks and transparency of photographs."""

    @property
    def keep(self) -> Literal["white", "black", False] | None:
        """As ``find_photographs`` takes it."""
        return False if self.no_masks else self.masks
