"""The verbs that ``benchmarks.endurance`` kills, and the scene they work on."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import torch

from benchmarks.endurance_runs import Run, environment, run
from scoup.base.errors import ScoupError
from scoup.io import save_png
from scoup.io.regions.store import RegionStore
from scoup.uplift.region_sums import RegionSums
from scoup_lab.synthetic.folder import write_demo_scene
from scoup_lab.synthetic.scene import make_demo_scene

QUICK = ("--n-atoms", "16", "--effort", "fast")
FIELD, SHARD = "a.scoup", "a.scoup.1-of-2.sums"
FIELD_KEPT, SHARDS = "field", "shards"
SIDE, RECTANGLES = 64, 2  # of the plain photographs
_PROGRAM = "from scoup.cli.app import entry; entry()"


@dataclass(frozen=True)
class Scene:
    """The scene that verbs work on."""

    folder: Path  # of the scene: photographs, splat, cameras, regions; ``photographs`` in it has plainer ones
    views: int  # of it
    earlier: int  # views that the kept field has
    # folder of what verbs begin with: FIELD_KEPT, a field of some of the views and its region sums; SHARDS,
    # the shards of all views
    starts: Path
    work: Path  # folder that verbs write into


@dataclass(frozen=True)
class Verb:
    """A verb that is killed."""

    name: str  # of the row in the table
    # of the command, which runs in the folder ``Scene.work``, after the verb; SCENE stands for the scene's
    # folder
    arguments: tuple[str, ...]
    kept_in: Callable[[Path], int]  # counts the views of this verb that are kept in a folder of work
    may_begin_again: int  # views that are begun again after a kill, at most: by how the verb is made
    finished: str  # what the verb says, refused because its work is done
    n_views: Callable[[Scene], int]  # how many views it makes
    start: str = ""  # what it begins with, in ``Scene.starts``; "" for nothing
    # the outputs that must be new together, or none of them; the lock is that of the first
    new: tuple[str, ...] = ()

    def command(self, scene: Scene) -> list[str]:
        """Return the arguments of the program."""
        return [argument.replace("SCENE", str(scene.folder)) for argument in self.arguments]

    def run(self, scene: Scene, point: int = 0, after: float | None = None) -> Run:
        """Run the verb; see ``endurance_runs.run``."""
        return run(self.command(scene), scene.work, point, after)

    def prepare(self, scene: Scene) -> None:
        """Make the folder of work new."""
        shutil.rmtree(scene.work, ignore_errors=True)
        if self.start:
            shutil.copytree(scene.starts / self.start, scene.work)
        else:
            scene.work.mkdir(parents=True)

    def n_kept(self, scene: Scene) -> int:
        """Return views of this verb that are kept for its next run."""
        return self.kept_in(scene.work)

    def is_finished(self, run: Run) -> bool:
        """Return whether a run was refused because the work is done."""
        return run.code == 2 and re.search(self.finished, run.said) is not None

    def is_new(self, files: dict[str, bytes], wanted: dict[str, bytes]) -> bool:
        """Return whether all outputs that belong together are in their places, as of an undisturbed run."""
        return bool(self.new) and self._of_outputs(files) == self._of_outputs(wanted)

    def is_as_before(self, files: dict[str, bytes], before: dict[str, bytes]) -> bool:
        """Return whether none of them is."""
        return self._of_outputs(files) == self._of_outputs(before)

    def _of_outputs(self, files: dict[str, bytes]) -> dict[str, bytes]:
        """Return the files that are outputs, or in folders that are."""
        return {path: content for path, content in files.items() if path.split("/")[0] in self.new}

    def says_how_to_go_on(self, files: dict[str, bytes]) -> bool:
        """Return whether marks say which files are still to be put in their places."""
        return any(path.split("/")[0].endswith((".ready", ".unwanted")) for path in files)


def views_extracted(work: Path) -> int:
    """Return views in a folder of regions that can be read."""
    try:
        return len(RegionStore.open(work / "regions").stems())
    except ScoupError:
        return 0


def views_of_build(work: Path) -> int:
    """Return views in the region sums that an interrupted build has left."""
    return _n_views(work / f"{FIELD}.partial")


def views_of_update(work: Path) -> int:
    """Return views that an interrupted update has added."""
    return max(0, _n_views(work / f"{FIELD}.update.partial") - _n_views(work / f"{FIELD}.sums"))


def _n_views(path: Path) -> int:
    try:
        return len(RegionSums.open(path))
    except ScoupError:  # nothing was complete
        return 0


BUILD = ("build", "SCENE", *QUICK, "--out", FIELD)
OF_SHARD = ("build", "SCENE", "--out", FIELD, "--shard")
MERGE = ("merge", SHARD, f"{FIELD}.2-of-2.sums", *QUICK, "--keep-sums")
UPDATE = ("update", FIELD, "--scene", "SCENE", "--overwrite")
EXTRACT = (
    "extract",
    "SCENE/photographs",
    "--segmenter",
    "felzenszwalb",
    "--embedder",
    "colors",
    "--out",
    "regions",
)
THERE, NO_WORK = "already exists", "nothing to do"
WITH_SUMS = (FIELD, f"{FIELD}.sums")


# A merge rasterises nothing: it keeps no views for its next run.
VERBS = {
    verb.name: verb
    for verb in (
        Verb("build", BUILD, views_of_build, 1, THERE, lambda scene: scene.views, new=(FIELD,)),
        Verb("build --keep-sums", (*BUILD, "--keep-sums"), views_of_build, 1, THERE, lambda scene: scene.views,
             new=WITH_SUMS),
        Verb("build --shard", (*OF_SHARD, "1/2"), lambda work: _n_views(work / f"{SHARD}.partial"), 1, THERE,
             lambda scene: scene.views // 2, new=(SHARD,)),
        Verb("merge", MERGE, lambda _: 0, 0, THERE, lambda _: 0, SHARDS, WITH_SUMS),
        Verb("update --add", (*UPDATE, "--add", "all"), views_of_update, 1, NO_WORK,
             lambda scene: scene.views - scene.earlier, FIELD_KEPT, WITH_SUMS),
        Verb("extract", EXTRACT, views_extracted, 1, NO_WORK, lambda scene: scene.views),
    )
}  # fmt: skip


def make_scene(folder: Path, views: int = 12, width: int = 240, n_gaussians: int = 20_000) -> Scene:
    """Write a scene, and build the field of a third of its views."""
    scene = Scene(folder / "scene", views, views // 3, folder / "starts", folder / "starts" / "work")
    made = make_demo_scene(0, n_gaussians, width, width * 3 // 4, views, 1)
    write_demo_scene(made, scene.folder)
    write_photographs(scene.folder / "photographs", views)
    for number in ("1", "2"):
        _run(scene, SHARDS, (*OF_SHARD, f"{number}/2"))
    features, hidden = scene.folder / "language_features", folder / "later"
    hidden.mkdir()
    for path in sorted(features.iterdir())[2 * scene.earlier :]:
        path.rename(hidden / path.name)
    _run(scene, FIELD_KEPT, (*BUILD, "--keep-sums"))
    for path in hidden.iterdir():
        path.rename(features / path.name)
    hidden.rmdir()
    return scene


def _run(scene: Scene, start: str, arguments: tuple[str, ...]) -> None:
    """Run a verb that makes what others begin with, as deep as these work, since a field names its splat relative to
    its folder."""
    folder = scene.starts / start
    folder.mkdir(parents=True, exist_ok=True)
    command = [
        sys.executable,
        "-c",
        _PROGRAM,
        *(argument.replace("SCENE", str(scene.folder)) for argument in arguments),
    ]
    subprocess.run(command, cwd=folder, env=environment(), check=True, stdout=subprocess.DEVNULL)


def write_photographs(folder: Path, count: int) -> None:
    """Write pictures of a few rectangles: those of the scene have hundreds of regions, and each takes time."""
    generator = torch.Generator().manual_seed(0)
    for number in range(count):
        picture = torch.full((SIDE, SIDE, 3), 90, dtype=torch.uint8)
        for _ in range(RECTANGLES):
            top, left = torch.randint(SIDE // 2, (2,), generator=generator).tolist()
            picture[top : top + SIDE // 2, left : left + SIDE // 3] = torch.randint(
                255, (3,), generator=generator
            )
        save_png(picture, folder / f"photograph_{number:02}.png")
