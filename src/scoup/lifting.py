"""Views into a build's accumulators, round after round, kept together with the record of which views are in."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.cameras import Camera
from scoup.checkpoint import BuildState, Checkpoint
from scoup.codes import SparseCodes
from scoup.processes import Processes
from scoup.progress import Progress
from scoup.regions import Regions
from scoup.rounds import next_agreement, spread
from scoup.uplifting import (
    RegionSums,
    ViewSums,
    add_view,
    codes_of_view,
    digest_of_labels,
    iterate_region_sums,
)

ALONE = Processes()
READERS = 4  # threads that read and hash views, each one ahead


@dataclass(frozen=True, eq=False)
class Source:
    """Where views come from: a scene to rasterise, or the region sums of one.

    Attributes:
        cameras: views with regions.
        regions: their label maps.
        raster_preset: rasteriser constants.
        scene: what is rasterised.
        sums: used in place of the scene if given.
    """

    cameras: Sequence[Camera]
    regions: Regions
    raster_preset: str
    scene: raster.PreparedScene | None = None
    sums: RegionSums | None = None

    def iterate_sums(self, cameras: Sequence[Camera]) -> Iterator[ViewSums]:
        """Region sums of some of the views; Gaussians as in the scene."""
        if self.sums is not None:
            wanted = {camera.name for camera in cameras}
            yield from (view for view in self.sums.views if view.view_name in wanted)
        elif self.scene is not None:
            yield from iterate_region_sums(self.scene, cameras, self.regions, self.raster_preset)


def load_labels(
    regions: Regions, cameras: Sequence[Camera], device: torch.device
) -> Iterator[tuple[Camera, Tensor, str]]:
    """(camera, labels [S, H, W] on the device, their digest) view by view.

    For a GPU the next views are read and hashed by other threads while this one is worked on, and copied from pinned
    memory; on a CPU it would only take the processor from it.
    """

    def load(camera: Camera) -> tuple[Camera, Tensor, str]:
        labels, _ = regions.load_view(camera.name, camera.width, camera.height)
        digest = digest_of_labels(labels)
        return camera, labels.pin_memory() if device.type == "cuda" else labels, digest

    if device.type == "cpu":
        yield from map(load, cameras)
        return
    with ThreadPoolExecutor(READERS) as readers:
        ahead: deque[Future] = deque()
        for camera in cameras:
            ahead.append(readers.submit(load, camera))
            if len(ahead) > READERS:
                taken, labels, digest = ahead.popleft().result()
                yield taken, labels.to(device, non_blocking=True), digest
        for future in ahead:
            taken, labels, digest = future.result()
            yield taken, labels.to(device, non_blocking=True), digest


class Lift:
    """Adds views to the accumulators of a build and stores the state now and then, and when interrupted.

    Args:
        state: codes, accumulators and the views already in them; changed in place.
        rows: per level, the rows of each view in the codes.
        n_views: of the whole build.
        keeper: where the state is stored.
        progress: told of each view.
        processes: each takes its share of the views; the accumulators are summed up at the end of a round, and only
            then is the state stored.
    """

    def __init__(
        self,
        state: BuildState,
        rows: Sequence[dict[str, slice]],
        n_views: int,
        keeper: Checkpoint,
        progress: Progress,
        processes: Processes = ALONE,
    ) -> None:
        self.state = state
        self.rows = rows
        self.n_views = n_views
        self.keeper = keeper
        self.progress = progress
        self.processes = processes

    def add_round(self, source: Source) -> None:
        """Take in every view that is not in yet."""
        left = [camera for camera in source.cameras if camera.name not in self.state.views_done]
        mine = self.processes.share(left)
        if left and not self.processes.first:
            self.state.accumulators.zero_()  # what an earlier run has left there counts once
        if source.sums is not None:
            self.add_sums(source.iterate_sums(mine))
        elif source.scene is not None:
            self.add_views(source.scene, mine, source.regions, source.raster_preset)
        if self.processes.world > 1 and left:
            self.processes.sum(self.state.accumulators)
            for done in self.processes.gather(self.state.views_done):
                self.state.views_done.update(done)
            self._report()

    def end_round(self, source: Source, keep: int) -> None:
        """Make what this round has found the yardstick of the next, and empty the accumulators.

        Args:
            source: of the views.
            keep: atoms of a Gaussian that are handed on.
        """
        state = self.state
        agreement = next_agreement(
            state.accumulators,
            torch.stack(state.atoms),
            keep,
            state.agreement,
            lambda: source.iterate_sums(spread(source.cameras)),
            self.codes_of,
        )
        state.end_round(agreement)
        if self.processes.first:
            self.keeper.write(state)

    def add_views(
        self, scene: raster.PreparedScene, cameras: Sequence[Camera], regions: Regions, raster_preset: str
    ) -> None:
        """Rasterise views and lift their codes; the accumulators are in the order of the prepared scene."""
        uplift = raster.Uplift(self.state.accumulators, scene.backend, self.state.agreement)
        self._report()
        at_hand = ("", "")  # name and digest of the view that is being taken in
        before = len(self.state.views_done)
        try:
            for camera, labels, digest in load_labels(regions, cameras, scene.gaussians.device):
                at_hand = (camera.name, digest)
                view = raster.look(scene, camera, raster_preset)
                uplift.add(view, labels, self.codes_of(camera.name))
                self.state.views_done[at_hand[0]] = at_hand[1]
                self._report()
                if self._may_store():
                    uplift.flush()
                    self.keeper.write(self.state)
        except KeyboardInterrupt:
            if self._stores_parts and uplift.intact:
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
                codes = self.codes_of(sums.view_name)
                self.state.between_views = False
                add_view(sums, codes, self.state.accumulators, self.state.agreement)
                self.state.views_done[sums.view_name] = sums.labels_digest
                self.state.between_views = True
                self._report()
                if self._may_store():
                    self.keeper.write(self.state)
        except KeyboardInterrupt:
            if self._stores_parts:
                self.keeper.write(self.state)
            raise

    def codes_of(self, view_name: str) -> list[SparseCodes]:
        """Per level, the codes of a view's regions."""
        return codes_of_view(self.state.codes, self.rows, view_name)

    @property
    def _stores_parts(self) -> bool:
        """Whether the state may be stored in the middle of a round: what one of several processes has is no state."""
        return self.keeper.path is not None and self.processes.world == 1

    def _may_store(self) -> bool:
        return self._stores_parts and self.keeper.is_due()

    def _report(self) -> None:
        stage = "uplift" if self.state.rounds_done == 0 else f"uplift, round {self.state.rounds_done + 1}"
        self.progress(stage, len(self.state.views_done), self.n_views)
