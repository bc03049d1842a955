"""scoup catalog: every thing of a scene with a name, place, box and picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from scoup.base.counts import counted
from scoup.base.staging import staged
from scoup.cli.console import Console
from scoup.cli.options import OptionalNumber, OptionalPath, OptionGroups
from scoup.cli.query_options import FrameOptions, NamingOptions, check_metres

SHOWN = 12  # things printed; the files contain all


@dataclass(frozen=True, kw_only=True)
class MakeCatalog(NamingOptions, FrameOptions):
    """Name the things in a scene with words, and write a scene graph (catalog.json), a table (catalog.csv) and a page
    with pictures (index.html)."""

    option_groups: ClassVar[OptionGroups] = {"output": "out metres_per_unit"}

    out: OptionalPath = None
    """Folder to write. Default: <name of FIELD>_catalog here."""
    metres_per_unit: OptionalNumber = None
    """Length of the scene's unit in metres: the table is in metres, the scene graph has both."""

    def run(self, console: Console) -> None:
        """Name, relate and write."""
        from scoup.query.catalog_files import catalog_files, save_catalog
        from scoup.view.vocabulary import read_words

        check_metres(self.metres_per_unit)
        out = self.output_folder(self.out, "catalog")
        field = self.open_field()
        question = field.naming_question(read_words(self.words))
        field.encoder.close()  # models are large
        catalog = field.catalog(question, self.open_frame(field))
        cameras = list(field.cameras or ())
        files = catalog_files(catalog, cameras)
        with staged(out, files, self.overwrite) as hidden, console.progress() as progress:
            save_catalog(field, catalog, hidden, cameras, self.metres_per_unit, progress)
        largest = sorted(catalog.things, key=lambda thing: -thing.n_gaussians)[:SHOWN]
        for thing in largest:
            console.say(
                f"{thing.text or 'unnamed'}: thing {thing.number}, level {thing.level}, at {thing.describe()}"
            )
        shown = f" (the {SHOWN} largest are listed above)" if len(catalog.things) > SHOWN else ""
        relations = counted(len(catalog.relations), "relation")
        objects, things = counted(len(catalog.objects), "object"), counted(len(catalog.things), "thing")
        console.say(f"{out}: {things}{shown}, {objects}, {relations}")
        console.result({"out": out, "files": files, **catalog.to_dict(self.metres_per_unit)})
