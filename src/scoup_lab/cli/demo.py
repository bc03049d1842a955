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


@dataclass(frozen=True, kw_only=True)
class Demo:
    """Make a small scene, build its language field, query every object in it, and score the answers.

    Needs no network, no GPU and no data. Regions and embeddings are simulated; the truth comes from the scene's
    geometry. Afterwards OUT contains the scene as files (try `scoup build OUT/scene`), the field, a contact sheet of
    queries, and the scores.
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

        from scoup.base import write_text
        from scoup.io import save_png
        from scoup.view import ViewedField, export_page
        from scoup_lab.evaluate.demonstration import run_demo
        from scoup_lab.evaluate.demonstration_sheet import query_sheet
        from scoup_lab.synthetic.folder import FILES

        no_page = _page_problem()
        files = [FIELD, SHEET, SCORES, *([] if no_page else [PAGE]), *(f"scene/{name}" for name in FILES)]
        console.say(
            f"a scene of {counted(self.n_gaussians, 'Gaussian')}, {counted(self.views, 'view')} of "
            f"{self.width} x {self.height}"
        )
        size = self.n_gaussians, self.width, self.height, self.views
        with staged(self.out, files, self.common.overwrite) as hidden, console.progress() as progress:
            result = run_demo(hidden, 0, *size, progress=progress)
            save_png(query_sheet(result), hidden / SHEET)
            record = _record(result, hidden / FIELD, self.out)
            write_text(hidden / SCORES, json.dumps(record, indent=2))
            if not no_page:
                export_page(ViewedField(result.field), hidden / PAGE)  # with the words of its table
        _say_scores(console, result, record)
        page = no_page or f"{self.out / PAGE} (open it in a browser; it needs no server)"
        console.say(f"\npictures: {self.out / SHEET}\nscores:   {self.out / SCORES}")
        console.say(f"field:    {self.out / FIELD}\npage:     {page}")
        thing = result.scene.layout.favourites[0]
        console.say(f"query it: {command('query', self.out / FIELD, thing, '--camera', 'all')}")
        console.say(f"look at it, and type a word: {command('view', self.out / FIELD)}")
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
    """Print the scores of each name and their means, the size of the field and the seconds of each stage."""
    from scoup.field import part_sizes
    from scoup_lab.bench import markdown
    from scoup_lab.evaluate.demonstration import rows_by_name

    rows = []
    for row in rows_by_name(result):
        levels = sorted(row.levels.items(), key=lambda item: -item[1])
        chosen = " ".join(f"{level}{count}" for level, count in levels)
        rows.append([row.name, str(row.views), f"{row.iou:.2f}", f"{row.accuracy:.0%}", chosen])
    heads = ["query", "views", "IoU", "hit", "levels"]
    console.say(f"Every name that the held-out views show\n{markdown(heads, rows)}\n")
    low, high = record["miou_interval"]
    console.say(
        f"mIoU {record['miou']:.3f} (95 % interval over names {low:.3f} to {high:.3f}), "
        f"localisation {record['accuracy']:.1%}, over all (view, name) pairs"
    )
    console.say(
        f"the field: {record['field_bytes'] / 1e6:.2f} MB ({part_sizes(Path(record['out']) / FIELD)})"
    )
    for stage, value in result.seconds.items():
        console.say(f"  {value:6.1f} s  {stage}")
