"""What each verb writes, prints and answers machines, as a user runs it.

What is printed is in tests/messages.json. What is special of a verb, the other files here check.
"""

from __future__ import annotations

import re
import shlex
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import pytest

from cli_support import plain_photographs, printed, run_json, snapshot
from messages import check_message
from scoup.io import load_gaussians, save_gaussians
from uplift.edits import joined

VIEWS = [f"view_0{number}" for number in range(4)]
FREE = "--segmenter felzenszwalb --embedder colors"
REGIONS = ["regions.json", *(f"{view}.regions" for view in VIEWS)]
SUMS = ["scene", "view.view_00*", "view.view_01*", "view.view_02*", "view.view_03*"]
BUILT = "bytes coded seconds coding"
VERBS: dict[str, tuple[list[str], dict[str, Any], str]] = {
    "build scene --n-atoms 8 --model scene/words.npz": (
        ["scene.scoup"], {"field": "scene.scoup", "gaussians": 150, "views": 4}, BUILT),
    "build scene --n-atoms 8 --out a.scoup --model scene/words.npz --keep-sums a.sums": (
        ["a.scoup", *(f"a.sums/{name}.safetensors" for name in SUMS)],
        {"field": "a.scoup", "sums": "a.sums", "gaussians": 150, "views": 4}, f"{BUILT} sums_bytes"),
    "build scene --keep-sums a.sums --part 1/2": (
        [f"a.sums/{name}.safetensors" for name in (*SUMS[:2], SUMS[3])],
        {"sums": "a.sums", "views": 2, "of_views": 4}, "seconds"),
    "views scene/point_cloud.ply --width 24 --height 18 --up 0 -1 0 --views 2 --out own": (
        ["own/images/own_000.png", "own/images/own_001.png", "own/transforms.json", "own/views.png"],
        {"scene": "own", "views": 2}, "coverage coverage_by_three"),
    f"extract plain {FREE} --out regions": (
        [f"regions/{name}" for name in REGIONS],
        {"out": "regions", "photographs": 4, "chosen": 4, "made": 4, "kept": 0, "skipped": {},
         "embedding_model": "colors"}, "regions bytes stages seconds"),
    f"extract plain {FREE} --out regions --part 2/3": (
        ["regions/regions.json", "regions/view_01.regions"],
        {"out": "regions", "photographs": 4, "chosen": 4, "made": 1, "kept": 0, "skipped": {},
         "embedding_model": "colors", "part": 2, "of_parts": 3}, "regions bytes stages seconds"),
    "extract scene --show view_02": (
        ["view_02_regions.png"],
        {"out": "view_02_regions.png", "view": "view_02.png", "regions": {"s": 6, "m": 6, "l": 6}}, "covered"),
    "convert scene compact": ([f"compact/{name}" for name in REGIONS],
                              {"out": "compact", "views": 4}, "bytes_before bytes_after"),
    "convert scene a.spz": (["a.spz"], {"out": "a.spz", "gaussians": 150}, "bytes"),
    "convert scene a.compressed.ply": (["a.compressed.ply"], {"out": "a.compressed.ply", "gaussians": 150}, "bytes"),
    "query f.scoup kettle 'wooden table'": (
        ["f_queries/query.json", "f_queries/sheet.png"],
        {"out": "f_queries", "sheets": ["f_queries/sheet.png"]}, "answers places frame"),
    "query f.scoup kettle mug --camera view_00 --camera view_01 --pictures all --out a": (
        ["a/query.json", "a/sheet.png", *(f"a/{view}/{text}_{kind}.png" for view in VIEWS[:2]
                                          for text in ("kettle", "mug") for kind in ("heat", "mask", "overlay"))],
        {"out": "a", "sheets": ["a/sheet.png"]}, "answers places frame"),
    "query f.scoup kettle --pictures none --npz --coco --out a": (
        ["a/coco.json", "a/query.json", "a/view_00/relevancy.npz"],
        {"out": "a", "sheets": []}, "answers places frame"),
    "select f.scoup kettle --out a.ply": (
        ["a.ply"], {"out": "a.ply", "gaussians": 150, "expression": "kettle"},
        "written chosen selected texts place frame"),
    "select f.scoup kettle - mug --edit remove --out a.splat --picture a.png": (
        ["a.splat", "a.png"], {"out": "a.splat", "gaussians": 150, "expression": "kettle and not mug"},
        "written chosen selected texts place frame"),
    "label f.scoup kettle mug": (
        [f"f_labels/{name}" for name in ("labels.npy", "labels.json", "labels.ply", "colored.ply", "labels.png")],
        {"out": "f_labels", "gaussians": 150}, "files classes none"),
    "label f.scoup kettle mug --out a --outputs sidecar ids colors glb clouds maps sheet": (
        [f"a/{name}" for name in (
            "labels.npy", "labels.json", "labels.ply", "colored.ply", "labels.png", "labels.glb", "clouds/kettle.ply",
            "clouds/mug.ply", "clouds/none.ply", "maps/coco.json", *(f"maps/{view}.png" for view in VIEWS))],
        {"out": "a", "gaussians": 150}, "files classes none"),
    "catalog f.scoup": (
        ["f_catalog/catalog.csv", "f_catalog/catalog.json", "f_catalog/index.html", "f_catalog/pictures/*"],
        {"out": "f_catalog", "format": "scoup scene graph", "version": 1}, "files frame things objects relations"),
    "compare f.scoup f.scoup": (
        ["f_changes/compare.json", "f_changes/index.html"],
        {"out": "f_changes", "format": "scoup comparison", "version": 1, "changes": [], "source": "same frame"},
        "files transform scale agreeing things residual objects"),
    "render f.scoup --camera all": (
        [f"f_color/{view}.png" for view in VIEWS],
        {"out": "f_color", "files": [f"f_color/{view}.png" for view in VIEWS]}, ""),
    "render f.scoup --what codes": (
        ["f_codes/view_00.png"], {"out": "f_codes", "files": ["f_codes/view_00.png"]}, ""),
    "render f.scoup --what relevancy --query kettle --camera view_01 --out deep/a.png": (
        ["deep/a.png"], {"out": "deep/a.png", "files": ["deep/a.png"]}, ""),
    "transfer f.scoup edited.ply": (["edited.scoup"], {"field": "edited.scoup", "coded": 145, "not_coded": 1}, ""),
}  # fmt: skip
"""Files that it writes, with * for names that depend on the content; of the record for machines, what is always so and
the names of what is not."""
VARYING = re.compile(
    r"(?<=extent )[^,]+|\[[^]]*\]|\d+\.\d+|(?<=thing )\d+|\d+(?= s\b|% of the view|% alike| kB a| regions and)"
)
"""What is not the same on every machine, beside numbers of the record."""


def told(out: str, record: dict[str, Any]) -> str:
    """What was printed, with names for the numbers that the record has, too."""
    out = VARYING.sub("#", out)
    inside = [pair for part in record.values() if isinstance(part, dict) for pair in part.items()]
    for name, value in (*record.items(), *inside):
        if isinstance(value, int) and value >= 10:
            out = re.sub(rf"\b{value}\b", f"<{name}>", out)
    return re.sub(r"\d+(?= Gaussians)", "#", out)


@pytest.mark.parametrize("command", VERBS)
def test_a_verb(here: Path, command: str) -> None:
    splat = load_gaussians("scene")
    pasted = replace(splat, means=splat.means + 100).select([7])
    save_gaussians(joined(splat.select(slice(5, None)), pasted), "edited.ply")
    plain_photographs("plain")
    before = snapshot(here)
    files, always, others = VERBS[command]
    arguments = shlex.split(command)
    record = run_json(*arguments)
    assert record == {**record, **always}
    assert set(record) == {*always, *others.split()}
    after = snapshot(here)
    assert before.items() <= after.items()  # nothing else is touched
    found = [(name, each) for name in after.keys() - before.keys() for each in files if fnmatch(name, each)]
    assert {name for name, _ in found} == after.keys() - before.keys()
    assert {each for _, each in found} == set(files)
    check_message(told(printed(*arguments, "--overwrite"), record))
