"""Options that verbs share, and how options are shown in the help."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, TypeAlias

import tyro

CLIP_MODEL = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
"""LangSplat's, which verbs assume where no other is named."""

Flag = Annotated[bool, tyro.conf.arg(help_behavior_hint="")]
"""A switch that is off by default."""

# Their help gives the default in words, which say more than "None".
OptionalPath = Annotated[Path | None, tyro.conf.arg(metavar="PATH", help_behavior_hint="")]
OptionalText = Annotated[str | None, tyro.conf.arg(metavar="TEXT", help_behavior_hint="")]
OptionalInteger = Annotated[int | None, tyro.conf.arg(metavar="INT", help_behavior_hint="")]
OptionalNumber = Annotated[float | None, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="")]

FieldFile = Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FIELD", help_behavior_hint="")]
Texts = Annotated[
    tyro.conf.Positional[tuple[str, ...]], tyro.conf.arg(metavar="TEXT [TEXT ...]", help_behavior_hint="")
]

OptionGroups: TypeAlias = dict[str, str]
"""Title of a group in the help -> names of its fields, between spaces. Fields in no group come first."""


@dataclass(frozen=True)
class Common:
    """Options every verb takes."""

    option_groups: ClassVar[OptionGroups] = {"common": "device quiet as_json"}

    device: str = "cpu"
    """Device of the tensors: cpu, or cuda if torch has a GPU (experimental, see docs/gpu.md)."""
    quiet: Flag = False
    """Print nothing but warnings and errors."""
    as_json: Annotated[bool, tyro.conf.arg(name="json", help_behavior_hint="")] = False
    """Print one JSON object on standard output instead of text, for other programs."""


@dataclass(frozen=True)
class WritesCommon(Common):
    """Options of verbs that write files."""

    option_groups: ClassVar[OptionGroups] = {"common": "overwrite"}

    overwrite: Flag = False
    """Replace existing outputs."""
