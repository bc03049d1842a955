"""scoup words: the vectors of words, for machines without the model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scoup.base import InputError, check_output, counted
from scoup.cli.console import Console, command
from scoup.cli.options import CLIP_MODEL, AllCommon


@dataclass(frozen=True, kw_only=True)
class MakeWords:
    """Write a word table, with which scoup build and --text answer words on machines without the model.

    It contains the words of a list, and what answers are judged by: about a thousand everyday words, and the phrases
    object, things, stuff, texture.
    """

    model: str = CLIP_MODEL
    """The model that embedded the regions: a folder or hub id of a CLIP, SigLIP or TIPSv2, or
    open_clip:ARCH/PRETRAINED."""
    words: Path | None = None
    """File of words to ask for, one per line. Default: everyday words alone."""
    out: Path = Path("words.npz")
    """The table to write, an .npz file."""
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.io import read_words
        from scoup.models import CANONICAL_PHRASES, EVERYDAY_WORDS, TextEncoder, WordTable

        WordTable.check_name(self.out)
        check_output(self.out, overwrite=self.common.overwrite)
        if WordTable.is_meant(self.model):
            raise InputError(f"{self.model}: is a word table, not a model; pass the model that made it")
        words = list(dict.fromkeys((*CANONICAL_PHRASES, *read_words(self.words), *EVERYDAY_WORDS)))
        with TextEncoder.open(self.model, device=self.common.device) as encoder:
            WordTable.save(self.out, words, encoder.encode(words), self.common.overwrite, encoder.name)
        console.say(
            f"{self.out}: {counted(len(words), 'word')} of {encoder.dim} dimensions; with it: "
            f"{command('build', 'SCENE', '--model', self.out)}, or "
            f"{command('query', 'FIELD', 'WORD', '--text', self.out)}"
        )
        console.result(
            {"out": self.out, "names": len(words), "dim": encoder.dim, "embedding_model": encoder.name}
        )
