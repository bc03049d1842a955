"""Options of verbs that take many scenes from a list."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from scoup.cli.options import OptionalInteger, OptionalPath, OptionalText, OptionGroups, WritesCommon


@dataclass(frozen=True, kw_only=True)
class ManifestOptions(WritesCommon):
    """One scene, or those of a list."""

    option_groups: ClassVar[OptionGroups] = {"many scenes": "manifest retries shard"}

    manifest: OptionalPath = None
    """Many scenes instead of one: a list of them with their options, YAML or JSON (docs/many_scenes.md). One that fails
    stops no other; those that are there already are passed over. Options given here count for every scene."""
    retries: OptionalInteger = None
    """With --manifest: how often a scene that fails is tried again. Default: 1; mistakes in its options or files are
    not tried again."""
    shard: OptionalText = None
    """With --manifest: I/N, such as 1/4, takes this share of the scenes. Under torchrun every process takes its own."""

    takes_shards: ClassVar[bool] = False
    """Whether ``shard`` means something for one scene, too."""

    def output(self, folder: Path) -> Path:
        """The file or folder that the verb makes of one scene; relative paths count from ``folder``."""
        raise NotImplementedError

    def check_without_manifest(self) -> None:
        """Refuse options that mean something with a list of scenes only."""
        from scoup.base.errors import InputError

        given = "--retries" if self.retries is not None else ""
        if self.shard is not None and not self.takes_shards:
            given = "--shard"
        if given:
            raise InputError(f"{given} goes with --manifest: it is about many scenes")
