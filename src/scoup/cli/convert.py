"""scoup convert: region features from one layout to the other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from scoup.base.counts import counted
from scoup.cli.console import Console
from scoup.cli.options import OptionalText, WritesCommon


@dataclass(frozen=True, kw_only=True)
class Convert(WritesCommon):
    """Write region features in the other layout: LangSplat's _s.npy and _f.npy, or one compact file a view.

    Labels are kept exactly. Embeddings are, too, with --bits 32; with 16 they are rounded to float16.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SOURCE", help_behavior_hint="")]
    """Folder of region features, or a scene with language_features in it."""
    target: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="TARGET", help_behavior_hint="")]
    """Folder to write."""
    to: Annotated[
        Literal["compact", "langsplat"] | None,
        tyro.conf.arg(metavar="{compact,langsplat}", help_behavior_hint=""),
    ] = None
    """Layout to write. Default: the one that SOURCE is not in."""
    bits: Literal[16, 32] = 16
    """Bits of a stored embedding number in the compact layout."""
    model: OptionalText = None
    """Id of the model that made the embeddings. Default: as SOURCE says; LangSplat's layout does not."""

    def run(self, console: Console) -> None:
        """Convert and report."""
        from scoup.io import convert_regions

        with console.progress() as progress:
            report = convert_regions(
                self.source, self.target, self.to, self.bits, self.model, self.overwrite, progress
            )
        before, after = (size / report.views / 1e3 for size in (report.bytes_before, report.bytes_after))
        console.say(
            f"{report.target}: {counted(report.views, 'view')} in the layout {report.layout}, {after:,.0f} kB a view "
            f"(they took {before:,.0f})"
        )
        console.result(
            {
                "out": report.target,
                "layout": report.layout,
                "views": report.views,
                "bytes_before": report.bytes_before,
                "bytes_after": report.bytes_after,
            }
        )
