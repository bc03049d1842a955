"""Kept region sums that an update changes: interrupted, it goes on where it stopped, and only with what is its own."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from cli_support import snapshot
from scoup import raster
from scoup.base.errors import ScoupWarning
from scoup.base.locks import locked_output
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.regions import Regions
from scoup.uplift.checkpoint import copy_for_update
from scoup.uplift.rasterise import add_views, region_sums
from scoup.uplift.region_sums import RegionSums
from scoup.uplift.storage.paths import view_file
from support import small_scene

PARTIAL = Path("a.scoup.update.partial")
SOURCE = Path("kept.sums")


class Interrupted(Exception):
    """In place of a kill."""


class Updated:
    """The last two views of four, added to the sums of the first two."""

    def __init__(self) -> None:
        self.gaussians, self.cameras, self.regions = small_scene(count=60, views=4)
        region_sums(self.gaussians, Cameras(list(self.cameras)[:2]), self.regions, path=SOURCE)
        self.add = list(self.cameras)[2:]

    def run(self, stop_at: str = "", add: Sequence[Camera] = (), regions: Regions | None = None) -> list[str]:
        """Update; returns the views that were rasterised.

        Args:
            stop_at: "n" views added, "codes" for after that; "" for to the end.
            add: other views.
            regions: other regions.
        """
        add, regions, rasterised = add or self.add, regions or self.regions, []
        with (
            locked_output(Path("a.scoup")) as output,
            copy_for_update(SOURCE, Path("a.scoup"), add, regions) as copied,
        ):
            for camera in add:
                if str(copied.n_added) == stop_at:
                    raise Interrupted
                before = dict(copied.sums.views)
                add_views(copied.sums, self.gaussians, [camera], regions)
                rasterised += [
                    name for name, view in copied.sums.views.items() if before.get(name) is not view
                ]
            copied.sums.keep_codes({"key": ""}, {})
            if stop_at:
                raise Interrupted
            with output.appearing(copied.sums.path, Path("a.scoup.sums")) as temporary:
                temporary.write_text("field")
        return rasterised


@pytest.fixture
def updated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Updated:
    monkeypatch.chdir(tmp_path)
    return Updated()


def whole(updated: Updated) -> dict[str, bytes]:
    """The sums of an update that nobody interrupts."""
    updated.run()
    content = snapshot(Path("a.scoup.sums"))
    shutil.rmtree("a.scoup.sums")
    Path("a.scoup").unlink()
    return content


@pytest.mark.parametrize(("stop_at", "again"), [("0", 2), ("1", 1), ("codes", 0)])
def test_it_goes_on_where_it_stopped(updated: Updated, stop_at: str, again: int) -> None:
    wanted = whole(updated)
    with pytest.raises(Interrupted):
        updated.run(stop_at)
    assert PARTIAL.exists() == (again < 2)  # nothing is left where nothing was added
    assert len(updated.run()) == again
    assert snapshot(Path("a.scoup.sums")) == wanted
    assert not PARTIAL.exists()


@pytest.mark.parametrize("file", ["scene.safetensors", "codes.safetensors", view_file("view_02.png")])
def test_a_damaged_copy(updated: Updated, file: str) -> None:
    """Files of a copy appear whole, so that somebody else must have cut it."""
    wanted, kept = whole(updated), snapshot(SOURCE)
    with pytest.raises(Interrupted):
        updated.run("codes")
    content = (PARTIAL / file).read_bytes()
    (PARTIAL / file).unlink()  # it may be a link to what is kept
    (PARTIAL / file).write_bytes(content[:-1])
    with pytest.warns(ScoupWarning, match="belongs to another update; starting over"):
        updated.run()
    assert snapshot(Path("a.scoup.sums")) == wanted
    assert snapshot(SOURCE) == kept


@pytest.mark.parametrize("file", ["codes.safetensors", view_file("view_00.png")])
def test_a_copy_that_lacks_a_file(updated: Updated, file: str) -> None:
    """As after a kill, wherever it comes: what is kept is taken from there again."""
    wanted = whole(updated)
    with pytest.raises(Interrupted):
        updated.run("codes")
    (PARTIAL / file).unlink()
    assert len(updated.run()) == 0
    assert snapshot(Path("a.scoup.sums")) == wanted


def test_where_the_file_system_knows_no_links(updated: Updated, monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = whole(updated)

    def refuse(*_) -> None:
        raise OSError(1, "Operation not permitted")

    monkeypatch.setattr("os.link", refuse)
    updated.run()
    assert snapshot(Path("a.scoup.sums")) == wanted


def test_views_that_have_changed_meanwhile_are_made_again(updated: Updated) -> None:
    with pytest.raises(Interrupted):
        updated.run("codes")
    first, changed = (camera.name for camera in updated.add)
    of = {first: first, changed: updated.cameras[0].name}
    others = Regions(updated.regions.levels, of, lambda name, level: updated.regions.load(of[name], level))
    wanted = [(changed, digest) for digest in (others_digest(updated, others, changed),)]
    assert updated.run(regions=others) == [changed]
    view = RegionSums.open("a.scoup.sums").views[changed]
    assert [(changed, view.labels_digest)] == wanted


def others_digest(updated: Updated, regions: Regions, name: str) -> str:
    camera = updated.cameras[name]
    return raster.combine(regions.load_labels(name, camera.width, camera.height)).digest()


def test_an_update_of_other_views_keeps_only_its_own(updated: Updated) -> None:
    with pytest.raises(Interrupted):
        updated.run("codes")
    second = updated.add[1]
    assert updated.run(add=[second]) == []
    assert list(RegionSums.open("a.scoup.sums").views) == [*RegionSums.open(SOURCE).views, second.name]


def test_other_sums_of_the_scene_are_continued(updated: Updated) -> None:
    """Views are the same, whichever others there are."""
    with pytest.raises(Interrupted):
        updated.run("codes")
    shutil.rmtree(SOURCE)
    region_sums(updated.gaussians, Cameras([updated.cameras[1]]), updated.regions, path=SOURCE)
    assert len(updated.run()) == 0
    assert len(RegionSums.open("a.scoup.sums")) == 3


def test_sums_of_another_scene_are_not_continued(updated: Updated) -> None:
    with pytest.raises(Interrupted):
        updated.run("codes")
    shutil.rmtree(SOURCE)
    updated.gaussians, _, _ = small_scene(count=61, views=4)
    region_sums(updated.gaussians, Cameras([updated.cameras[1]]), updated.regions, path=SOURCE)
    with pytest.warns(
        ScoupWarning, match="^a.scoup.update.partial: belongs to another update; starting over"
    ):
        assert len(updated.run()) == 2
    assert len(RegionSums.open("a.scoup.sums")) == 3
