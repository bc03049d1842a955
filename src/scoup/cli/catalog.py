"""scoup catalog: every thing of a scene with a name, place, box and picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from scoup.base import counted
from scoup.cli.console import Console
from scoup.cli.options import AllCommon, FieldFile, arg
from scoup.cli.query_options import FrameOptions, TextOptions, WordOptions, output_folder

SHOWN = 12  # things printed; the files contain all


@dataclass(frozen=True, kw_only=True)
class MakeCatalog:
    """Name the things in a scene with words, and write a scene graph (catalog.json), a table (catalog.csv) and a page
    with pictures (index.html)."""

    field: FieldFile
    """The .scoup file."""
    out: Path | None = None
    """Folder to write. Default: <name of FIELD>_catalog here."""
    words: WordOptions = WordOptions()
    directions: FrameOptions = FrameOptions()
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.io import read_words
        from scoup.query import save_catalog

        out = output_folder(self.out, self.field, "catalog")
        field = self.opening.open(self.field, self.common.device)
        question = field.naming_question(read_words(self.words.words))
        field.encoder.close()  # models are large
        catalog = field.catalog(question, self.directions.frame(field))
        cameras = list(field.cameras or ())
        with console.progress() as progress:
            files = save_catalog(field, catalog, out, cameras, self.common.overwrite, progress)
        largest = sorted(catalog.things, key=lambda thing: -thing.n_gaussians)[:SHOWN]
        for thing in largest:
            console.say(
                f"{thing.text and f'{thing.text}: '}thing {thing.number}, level {thing.level}, at {thing.describe()}"
            )
        shown = f" (the {SHOWN} largest are listed above)" if len(catalog.things) > SHOWN else ""
        relations = counted(len(catalog.relations), "relation")
        objects, things = counted(len(catalog.objects), "object"), counted(len(catalog.things), "thing")
        console.say(f"{out}: {things}{shown}, {objects}, {relations}")
        console.result({"out": out, "files": files, **catalog.to_dict()})
