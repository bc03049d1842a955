"""The verbs that ``benchmarks.endurance`` kills, and the scene they work on."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import torch

from benchmarks.endurance_runs import Run, environment
from scoup.base.errors import ScoupError
from scoup.io import save_png
from scoup.io.regions.store import RegionStore
from scoup.synthetic.folder import write_demo_scene
from scoup.synthetic.scene import make_demo_scene
from scoup.uplift.region_sums import RegionSums

QUICK = ("--n-atoms", "16", "--effort", "fast")
FIELD = "a.scoup"
SIDE, RECTANGLES = 64, 2  # of the plain photographs
_PROGRAM = (sys.executable, "-c", "from scoup.cli.app import entry; entry()")


@dataclass(frozen=True)
class Scene:
    """What verbs work on.

    Attributes:
        folder: of the scene: photographs, splat, cameras, regions; ``photographs`` in it has plainer ones.
        views: of it.
        earlier: views that the kept field of ``kept`` has.
        kept: folder with a field of some of the views, and its region sums.
        work: folder that verbs write into.
    """

    folder: Path
    views: int
    earlier: int
    kept: Path
    work: Path

    def n_views(self, verb: Verb) -> int:
        """How many views a verb makes."""
        return self.views - self.earlier if verb.on_kept else self.views


@dataclass(frozen=True)
class Verb:
    """A verb that is killed.

    Attributes:
        name: of the row in the table.
        arguments: of the command, which runs in the folder ``Scene.work``, after the verb; SCENE stands for the scene's
            folder.
        kept_in: counts the views of this verb that are kept in a folder of work.
        may_begin_again: views that are begun again after a kill, at most: by how the verb is made.
        finished: what the verb says, refused because its work is done.
        on_kept: it begins with the kept field of some of the views.
        new: the outputs that must be new together, or none of them.
    """

    name: str
    arguments: tuple[str, ...]
    kept_in: Callable[[Path], int]
    may_begin_again: int
    finished: str
    on_kept: bool = False
    new: tuple[str, ...] = ()

    def command(self, scene: Scene) -> list[str]:
        """The arguments of the program."""
        return [argument.replace("SCENE", str(scene.folder)) for argument in self.arguments]

    def prepare(self, scene: Scene) -> None:
        """Make the folder of work new."""
        shutil.rmtree(scene.work, ignore_errors=True)
        if self.on_kept:
            shutil.copytree(scene.kept, scene.work)
        else:
            scene.work.mkdir(parents=True)

    def n_kept(self, scene: Scene) -> int:
        """Views of this verb that are kept for its next run."""
        return self.kept_in(scene.work)

    def is_finished(self, run: Run) -> bool:
        """Whether a run was refused because the work is done."""
        return run.code == 2 and re.search(self.finished, run.said) is not None

    def is_new(self, files: dict[str, bytes], wanted: dict[str, bytes]) -> bool:
        """Whether all outputs that belong together are in their places, as of an undisturbed run."""
        return bool(self.new) and all(files.get(name) == wanted[name] for name in self.new)

    def is_as_before(self, files: dict[str, bytes], before: dict[str, bytes]) -> bool:
        """Whether none of them is."""
        return all(files.get(name) == before.get(name) for name in self.new)

    def says_how_to_go_on(self, files: dict[str, bytes]) -> bool:
        """Whether the lock says which files are still to be put in their places."""
        return b'"last_steps"' in files.get(f"{FIELD}.lock", b"")


def views_of_build(work: Path) -> int:
    """Views in the region sums that an interrupted build has left."""
    return _n_views(work / f"{FIELD}.partial")


def views_of_update(work: Path) -> int:
    """Views that an interrupted update has added."""
    return max(0, _n_views(work / f"{FIELD}.update.partial") - _n_views(work / f"{FIELD}.sums"))


def views_extracted(work: Path) -> int:
    """Views in a folder of regions that can be read."""
    try:
        return len(RegionStore.open(work / "regions").stems())
    except ScoupError:
        return 0


def _n_views(path: Path) -> int:
    try:
        with closing(RegionSums.open(path)) as sums:
            return len(sums)
    except ScoupError:  # nothing was complete
        return 0


BUILD = ("build", "SCENE", *QUICK, "--out", FIELD)
UPDATE = ("update", FIELD, "--scene", "SCENE", "--add", "all", "--overwrite")
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
# Of build and update, a view is written while the next is rasterised: both are begun again.
VERBS = {
    verb.name: verb
    for verb in (
        Verb("build", BUILD, views_of_build, 2, "already exists", new=(FIELD,)),
        Verb("build --keep-sums", (*BUILD, "--keep-sums"), views_of_build, 2, "already exists",
             new=(FIELD, f"{FIELD}.sums")),
        Verb("update", UPDATE, views_of_update, 2, "nothing to do", on_kept=True, new=(FIELD, f"{FIELD}.sums")),
        Verb("extract", EXTRACT, views_extracted, 1, "nothing to do"),
    )
}  # fmt: skip


def make_scene(folder: Path, views: int = 12, width: int = 240, n_gaussians: int = 20_000) -> Scene:
    """Write a scene, and build the field of a third of its views.

    Args:
        folder: for all of it; must not exist.
        views: of the scene.
        width: of the photographs; they are three quarters as high.
        n_gaussians: of the scene.
    """
    scene = Scene(folder / "scene", views, views // 3, folder / "kept", folder / "work")
    write_demo_scene(make_demo_scene(0, n_gaussians, width, width * 3 // 4, views, 1), scene.folder)
    write_photographs(scene.folder / "photographs", views)
    scene.kept.mkdir()
    features = scene.folder / "language_features"
    hidden = folder / "later"
    hidden.mkdir()
    for path in sorted(features.iterdir())[2 * scene.earlier :]:
        path.rename(hidden / path.name)
    # Where it will be used, as the field names its splat relative to its folder.
    command = [*_PROGRAM, *VERBS["build --keep-sums"].command(scene)]
    subprocess.run(command, cwd=scene.kept, env=environment(), check=True, stdout=subprocess.DEVNULL)
    for path in hidden.iterdir():
        path.rename(features / path.name)
    hidden.rmdir()
    return scene


def write_photographs(folder: Path, count: int) -> None:
    """Pictures of a few rectangles: those of the scene have hundreds of regions, for each of which time would pass."""
    generator = torch.Generator().manual_seed(0)
    for number in range(count):
        picture = torch.full((SIDE, SIDE, 3), 90, dtype=torch.uint8)
        for _ in range(RECTANGLES):
            top, left = torch.randint(SIDE // 2, (2,), generator=generator).tolist()
            picture[top : top + SIDE // 2, left : left + SIDE // 3] = torch.randint(
                255, (3,), generator=generator
            )
        save_png(picture, folder / f"photograph_{number:02}.png")
