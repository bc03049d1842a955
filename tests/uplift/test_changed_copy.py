"""Kept region sums that an update changes: interrupted, it goes on where it stopped, and only with what is its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pytest

from scoup import raster
from scoup.base.errors import ScoupWarning
from scoup.base.locks import locked_file
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.regions import Regions
from scoup.uplift.checkpoint import changed_copy, moved_with_sums
from scoup.uplift.rasterise import add_views, region_sums
from scoup.uplift.region_sums import RegionSums
from support import small_scene

PARTIAL = Path("a.scoup.update.partial")
SOURCE = Path("kept.sums")


class Interrupted(Exception):
    """In place of a kill."""


class Updated:
    """The last two views of four, added to the sums of the first two."""

    def __init__(self) -> None:
        self.gaussians, self.cameras, self.regions = small_scene(count=60, views=4)
        region_sums(self.gaussians, Cameras(list(self.cameras)[:2]), self.regions, path=SOURCE).close()
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
            locked_file(Path("a.scoup")) as lock,
            changed_copy(SOURCE, Path("a.scoup"), add, regions) as copied,
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
            Path("a.scoup.new").write_text("field")
            moved_with_sums(lock, copied.sums, keep=True)(Path("a.scoup.new"), Path("a.scoup"))
        return rasterised


@pytest.fixture
def updated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Updated:
    monkeypatch.chdir(tmp_path)
    return Updated()


def whole(updated: Updated) -> bytes:
    """The sums of an update that nobody interrupts."""
    updated.run()
    content = Path("a.scoup.sums").read_bytes()
    Path("a.scoup.sums").unlink()
    Path("a.scoup").unlink()
    return content


@pytest.mark.parametrize(("stop_at", "again"), [("0", 2), ("1", 1), ("codes", 0)])
def test_it_goes_on_where_it_stopped(updated: Updated, stop_at: str, again: int) -> None:
    wanted = whole(updated)
    with pytest.raises(Interrupted):
        updated.run(stop_at)
    assert PARTIAL.exists() == (again < 2)  # nothing is left where nothing was added
    assert len(updated.run()) == again
    assert Path("a.scoup.sums").read_bytes() == wanted
    assert not PARTIAL.exists()


@pytest.mark.parametrize("length", [-1, -70, 1, 40])
def test_a_copy_that_was_cut_short(updated: Updated, length: int) -> None:
    wanted = whole(updated)
    with pytest.raises(Interrupted):
        updated.run("codes")
    PARTIAL.write_bytes(PARTIAL.read_bytes()[:length])
    if length > 0:  # a copy appears whole, so that somebody else must have cut it
        with pytest.warns(ScoupWarning, match="is not of this update; starting over"):
            updated.run()
    else:
        assert len(updated.run()) == 0  # only the codes were cut
    assert Path("a.scoup.sums").read_bytes() == wanted


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


def test_an_update_of_other_views_starts_over(updated: Updated) -> None:
    with pytest.raises(Interrupted):
        updated.run("codes")
    second = updated.add[1]
    assert updated.run(add=[second]) == [second.name]
    assert list(RegionSums.open("a.scoup.sums").views) == [*RegionSums.open(SOURCE).views, second.name]


def test_other_sums_are_not_continued(updated: Updated) -> None:
    with pytest.raises(Interrupted):
        updated.run("codes")
    SOURCE.unlink()
    region_sums(updated.gaussians, Cameras([updated.cameras[1]]), updated.regions, path=SOURCE).close()
    with pytest.warns(ScoupWarning, match="^a.scoup.update.partial: is not of this update; starting over"):
        assert len(updated.run()) == 2
    assert len(RegionSums.open("a.scoup.sums")) == 3
