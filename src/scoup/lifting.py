"""Views into a build's accumulators, kept together with the record of which views are in."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from scoup import raster
from scoup.cameras import Camera
from scoup.checkpoint import BuildState, Checkpoint
from scoup.codes import SparseCodes
from scoup.progress import Progress
from scoup.regions import Regions
from scoup.uplifting import ViewSums, add_view, digest_of_labels


class Lift:
    """Adds views to the accumulators of a build and stores the state now and then, and when interrupted.

    Args:
        state: codes, accumulators and the views already in them; changed in place.
        rows: per level, the rows of each view in the codes.
        n_views: of the whole build.
        keeper: where the state is stored.
        progress: told of each view.
    """

    def __init__(
        self,
        state: BuildState,
        rows: Sequence[dict[str, slice]],
        n_views: int,
        keeper: Checkpoint,
        progress: Progress,
    ) -> None:
        self.state = state
        self.rows = rows
        self.n_views = n_views
        self.keeper = keeper
        self.progress = progress

    def add_views(
        self, scene: raster.PreparedScene, cameras: Sequence[Camera], regions: Regions, raster_preset: str
    ) -> None:
        """Rasterise views and lift their codes; the accumulators are in the order of the prepared scene."""
        uplift = raster.Uplift(self.state.accumulators, scene.backend)
        self._report()
        at_hand = ("", "")  # name and digest of the view that is being taken in
        before = len(self.state.views_done)
        try:
            for camera in cameras:
                labels, _ = regions.load_view(camera.name, camera.width, camera.height)
                at_hand = (camera.name, digest_of_labels(labels))
                labels = labels.to(scene.gaussians.device)
                view = raster.look(scene, camera, raster_preset)
                uplift.add(view, labels, self._codes(camera.name))
                self.state.views_done[at_hand[0]] = at_hand[1]
                self._report()
                if self.keeper.is_due():
                    uplift.flush()
                    self.keeper.write(self.state)
        except KeyboardInterrupt:
            if self.keeper.path is not None and uplift.intact:
                # The interruption may have come after the view was taken in.
                if uplift.n_taken > len(self.state.views_done) - before:
                    self.state.views_done[at_hand[0]] = at_hand[1]
                uplift.flush()
                self.keeper.write(self.state)
            raise
        uplift.flush()

    def add_sums(self, sums_of_views: Iterable[ViewSums]) -> None:
        """Lift codes through region sums at hand."""
        self._report()
        try:
            for sums in sums_of_views:
                codes = self._codes(sums.view_name)
                self.state.between_views = False
                add_view(sums, codes, self.state.accumulators)
                self.state.views_done[sums.view_name] = sums.labels_digest
                self.state.between_views = True
                self._report()
                if self.keeper.is_due():
                    self.keeper.write(self.state)
        except KeyboardInterrupt:
            self.keeper.write(self.state)
            raise

    def _codes(self, view_name: str) -> list[SparseCodes]:
        return [codes.rows(rows[view_name]) for codes, rows in zip(self.state.codes, self.rows, strict=True)]

    def _report(self) -> None:
        self.progress("uplift", len(self.state.views_done), self.n_views)
