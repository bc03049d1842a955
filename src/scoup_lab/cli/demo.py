"""scoup demo: a small synthetic scene, its language field, queries, pictures and scores."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scoup.base import counted, staged
from scoup.cli import Console, WritesCommon, command

if TYPE_CHECKING:
    from scoup_lab.evaluate.demonstration import DemoResult


FIELD, SHEET, SCORES, PAGE = "demo.scoup", "queries.png", "scores.json", "demo.html"
ASKED = ("teapot", "mug left of the laptop", "elephant")
"""A text that the scene answers, one with a relation, and one that is not there."""


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Make a small scene, build its language field, query every object in it, and score the answers.

    Needs no network, no GPU and no data. Regions and embeddings are simulated: it finds the names of
    OUT/scene/words.txt and knows few other words; the truth comes from the scene's geometry. Afterwards OUT contains
    the scene as files (try `scoup build OUT/scene`), the field, a contact sheet of queries, and the scores.
    """

    out: Path = Path("demo")
    """Folder for all outputs."""
    n_gaussians: int = 160_000
    """Gaussians in the scene."""
    width: int = 480
    """Width of the views, in pixels."""
    height: int = 360
    """Height of the views, in pixels."""
    views: int = 24
    """Views the field is built from; a quarter as many are held out for scoring."""
    common: WritesCommon = WritesCommon()

    def run(self, console: Console) -> None:
        """Run, draw, print."""
        import json

        console.say(
            f"a simulated scene of {counted(self.n_gaussians, 'Gaussian')}, {counted(self.views, 'view')} of "
            f"{self.width} x {self.height}"
        )
        from scoup.base import write_text
        from scoup.io import save_png
        from scoup.view import ViewedField, export_page
        from scoup_lab.evaluate.demonstration import run_demo
        from scoup_lab.evaluate.demonstration_sheet import query_sheet
        from scoup_lab.synthetic.folder import FILES

        no_page = _page_problem()
        files = [FIELD, SHEET, SCORES, *([] if no_page else [PAGE]), *(f"scene/{name}" for name in FILES)]
        size = self.n_gaussians, self.width, self.height, self.views
        with staged(self.out, files, self.common.overwrite) as hidden, console.progress() as progress:
            result = run_demo(hidden, 0, *size, progress=progress)
            save_png(query_sheet(result), hidden / SHEET)
            record = _record(result, hidden / FIELD, self.out)
            write_text(hidden / SCORES, json.dumps(record, indent=2))
            if not no_page:
                export_page(ViewedField(result.field), hidden / PAGE)  # with the words of its table
            story = {
                text: result.field.location(text).describe() for text in ASKED
            }  # while its table is there
        _say_scores(console, result, record)
        _say_story(console, story, self.out, no_page)
        console.result(record)


def _page_problem() -> str:
    """Return why no page can be written; empty if it can."""
    from scoup.base import ScoupError
    from scoup.view import check_needed

    try:
        check_needed(serves=False)
    except ScoupError as error:
        return str(error)
    return ""


def _record(result: DemoResult, field: Path, out: Path) -> dict[str, Any]:
    from dataclasses import asdict

    import torch

    from scoup_lab.evaluate.demonstration import rows_by_name
    from scoup_lab.evaluate.scores import miou_interval

    return {
        "layout": result.scene.layout.name,
        "gaussians": len(result.field),
        "coded": int(result.field.coded().sum()),
        "field_bytes": field.stat().st_size,
        "miou": result.score.miou,
        "miou_interval": miou_interval([result.score]).ends,
        "accuracy": result.score.accuracy,
        "names": [asdict(row) for row in rows_by_name(result)],
        "seconds": {stage: round(value, 2) for stage, value in result.seconds.items()},
        "threads": torch.get_num_threads(),
        "coding": result.field.info.provenance["coding"],
        "out": str(out),
    }


def _say_scores(console: Console, result: DemoResult, record: dict[str, Any]) -> None:
    """Print the seconds of each stage, the size of the field and the mean score."""
    from scoup.field import part_sizes

    for stage, value in result.seconds.items():
        console.say(f"  {value:6.1f} s  {stage}")
    out = Path(record["out"])
    size = f"{record['field_bytes'] / 1e6:.2f} MB ({part_sizes(out / FIELD)})"
    low, high = record["miou_interval"]
    console.say(f"the field: {size}")
    console.say(
        f"mIoU {record['miou']:.3f} (95 % interval over names {low:.3f} to {high:.3f}), localisation "
        f"{record['accuracy']:.1%}, over all (view, name) pairs of held-out views; each name: {out / SCORES}"
    )


def _say_story(console: Console, story: dict[str, str], out: Path, no_page: str) -> None:
    """Print answers, where the pictures are, the words that can be asked, and the next step."""
    console.say("\nthree questions to it:")
    for text, answer in story.items():
        console.say(f"  {text}: {answer}")
    page = no_page or f"{out / PAGE} (open it in a browser; it needs no server)"
    console.say(f"\npictures: {out / SHEET}\npage:     {page}")
    console.say(
        f"words:    regions and embeddings are simulated: it finds the names of {out / 'scene' / 'words.txt'}"
    )
    console.say(f"as files: {command('query', out / FIELD, *ASKED, '--camera', 'all')}")
    console.say(f"next:     {command('view', out / FIELD)}, then type a word")
