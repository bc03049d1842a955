"""scoup compare: what was added, removed and moved between two captures of one place."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from scoup.base import counted
from scoup.cli.console import Console
from scoup.cli.options import AllCommon, arg
from scoup.cli.query_options import FieldOptions, TextOptions, WordOptions, output_folder


@dataclass(frozen=True, kw_only=True)
class CaptureOptions(TextOptions):
    """Options of verbs that open two fields."""

    new_gaussians: Path | None = None
    """The splat that NEW was built on; --gaussians is that of OLD. Default: the one NEW names."""
    transform: Path | None = None
    """Text or JSON file with 4 x 4 numbers: the rotation, scale and translation from the frame of NEW to that of OLD.
    Default: things that both captures contain give it."""


@dataclass(frozen=True, kw_only=True)
class CompareCaptures:
    """Find the objects that were added, removed or moved between two captures of one place, and write them as
    compare.json and a page with pictures (index.html)."""

    old: Annotated[tyro.conf.Positional[Path], arg(metavar="OLD")]
    """The .scoup file of the first capture."""
    new: Annotated[tyro.conf.Positional[Path], arg(metavar="NEW")]
    """The .scoup file of the second one, with embeddings of the same model."""
    out: Path | None = None
    """Folder to write. Default: <name of NEW>_changes here."""
    opening: Annotated[CaptureOptions, arg(name="field")] = CaptureOptions()
    words: WordOptions = WordOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.io import read_similarity, read_words
        from scoup.query import compare, save_comparison

        opening, device = self.opening, self.common.device
        out = output_folder(self.out, self.new, "changes")
        transform = None if opening.transform is None else read_similarity(opening.transform)
        old = opening.open(self.old, device)
        new = FieldOptions(gaussians=opening.new_gaussians).open(self.new, device, "--new-gaussians")
        new = new.with_encoder(old.encoder)
        words, overwrite = read_words(self.words.words), self.common.overwrite
        with console.progress() as progress:
            comparison = compare(old, new, words, transform)
            old.encoder.close()  # models are large
            files = save_comparison(old, new, comparison, out, overwrite, progress)
        console.say(comparison.registration.describe())
        for change in comparison.changes:
            thing = change.new or change.old
            assert thing is not None
            text = f"{thing.text and f'{thing.text}: '}thing {thing.number}, at {thing.describe()}"
            console.say(f"{comparison.describe(change)}, confidence {change.confidence:.2f}: {text}")
        changed = sum(change.kind != "unseen" for change in comparison.changes)
        console.say(
            f"{out}: {counted(changed, 'change')} among {comparison.counts[0]} and {comparison.counts[1]} objects"
        )
        console.result({"out": out, "files": files, **comparison.to_dict()})
