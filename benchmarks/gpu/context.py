"""What every stage is given: the device, sizes, one scene, the peer, and a way to hand over what it has."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from benchmarks.gpu.peers import Gsplat
from benchmarks.gpu.sizes import Sizes
from benchmarks.gpu.timing import Clock, Row, Unavailable, Work, add_ratios, measure, measure_once, reason
from scoup import raster
from scoup.bench import Workload, random_scene_cameras, random_scene_gaussians
from scoup.scene.cameras import Camera
from scoup.scene.codes import SparseCodes, index_dtype
from scoup.scene.gaussians import Gaussians
from scoup.synthetic.random_scene import CELLS, clip_like, voronoi_labels

PRESET = "gsplat"  # of both rasterisers, so that they draw the same picture


@dataclass(eq=False)
class Context:
    """Attributes:
    device: "cuda", or "cpu" with interpreted kernels.
    sizes: of everything.
    deadline: seconds since the epoch after which nothing new is begun.
    save: takes what the stage has so far.
    tell: told what is about to run, so that what breaks the device or hangs is known by its name.
    left_out: reasons not to run something, by name: it broke the device or hung in an earlier process.
    no_peer: why gsplat is not used, "" where it may be.
    result: of the stage that runs: "rows" and whatever else it tells.
    ceilings: what the device can do, once the stage of that name has run.
    """

    device: torch.device
    sizes: Sizes
    deadline: float
    save: Callable[[dict[str, Any]], None]
    tell: Callable[[str], None] = lambda what: None
    left_out: dict[str, str] = field(default_factory=dict)
    no_peer: str = ""
    result: dict[str, Any] = field(default_factory=dict)
    ceilings: dict[str, float] = field(default_factory=dict)
    _rooms: dict[int, Gaussians] = field(default_factory=dict)
    _gsplat: Gsplat | str | None = None
    _last_heartbeat: float = 0.0

    @property
    def clock(self) -> Clock:
        return Clock(self.device)

    def time_is_up(self) -> bool:
        return time.time() > self.deadline

    def begin(self) -> None:
        """Forget the last stage and what it kept on the device."""
        self.result = {"rows": []}
        gc.collect()
        self.clock.recover()

    def about_to(self, what: str) -> str | None:
        """Say what runs next; the reason where it must not."""
        self.tell(what)
        return self.left_out.get(what)

    def heartbeat(self, what: str, done: int = 0, total: int = 0) -> None:
        """Inside of something long: tell that it goes on; stop it where no time is left. A ``Progress``.

        Raises:
            Unavailable: the time is up.
        """
        now = time.time()
        if now > self.deadline:
            raise Unavailable(
                f"no time was left, at {done} of {total} of: {what}" if total else "no time was left"
            )
        if now > self._last_heartbeat + 1.0:
            self._last_heartbeat = now
            self.tell("")

    def rows(self, works: list[Work], over: dict[str, list[str]] | None = None) -> list[Row]:
        """Measure and keep; hand over whenever more is known, with ratios as for ``add_ratios``."""
        kept: list[Row] = self.result["rows"]
        before = len(kept)

        def known() -> None:
            add_ratios(kept[before:], over or {})
            self.save(self.result)

        return measure(
            works,
            self.clock,
            self.sizes.repeats,
            self.time_is_up,
            self.sizes.warm_up,
            into=kept,
            about_to=self.about_to,
            known=known,
        )

    def once(self, work: Work) -> Row:
        """``measure_once``, unless it is left out or no time is left."""
        left_out = self.about_to(work.name)
        if left_out is not None or self.time_is_up():
            return {"name": work.name, "reason": left_out or "no time was left"}
        return measure_once(work, self.clock)

    def gsplat(self) -> Gsplat:
        """The peer.

        Raises:
            Unavailable: it cannot be used here.
        """
        if self._gsplat is None and self.no_peer:
            self._gsplat = self.no_peer
        if self._gsplat is None:
            try:
                self._gsplat = Gsplat.found(self.device)
            except Exception as error:  # its compiler may fail in any way
                self._gsplat = reason(error)
        if isinstance(self._gsplat, str):
            raise Unavailable(self._gsplat)
        return self._gsplat

    def room(self, n_gaussians: int) -> Gaussians:
        """The room of that size, on the device. One is kept."""
        if n_gaussians not in self._rooms:
            self._rooms.clear()
            self._rooms[n_gaussians] = random_scene_gaussians(n_gaussians).to(self.device)
        return self._rooms[n_gaussians]

    def forget_rooms(self) -> None:
        """Leave the device's memory to what comes."""
        self._rooms.clear()
        self.clock.recover()

    def work(
        self,
        n_atoms: int,
        n_gaussians: int | None = None,
        size: tuple[int, int] | None = None,
        levels: int = 3,
    ) -> Workload:
        """The first view of a room with everything the rasteriser takes, on the device: codes in float16, as a field
        has them; a query and the canonical phrases.
        """
        sizes = self.sizes
        n_gaussians = n_gaussians or sizes.n_gaussians
        width, height = size or (sizes.width, sizes.height)
        gaussians = self.room(n_gaussians)
        camera = random_scene_cameras(1, width, height)[0]
        counts = [sizes.regions[level % len(sizes.regions)] for level in range(levels)]
        generator = torch.Generator().manual_seed(0)
        codes = [SparseCodes.from_dense(torch.rand(n, n_atoms, generator=generator), sizes.k) for n in counts]
        indices, weights = codes_nearby(gaussians.means, levels, n_atoms, sizes.k)
        work = Workload(
            "room",
            gaussians,
            camera,
            voronoi_labels(counts, width, height),
            codes,
            indices,
            weights,
            codebook=clip_like(levels * n_atoms, sizes.dim).view(levels, n_atoms, sizes.dim),
            queries=clip_like(5, sizes.dim, 1),  # one query and four canonical phrases
            values=raster.view_colors(gaussians, camera),
        )
        return replace(work.to(self.device), weights=work.weights.to(self.device).half())


def project(gaussians: Gaussians, camera: Camera) -> raster.Projection:
    """What all stages look with."""
    return raster.project(gaussians, camera, PRESET, "triton")


def codes_nearby(means: Tensor, n_levels: int, n_atoms: int, k: int) -> tuple[Tensor, Tensor]:
    """``random_scene_codes`` where the Gaussians are: neighbours share their atoms, and weights differ.

    Returns:
        indices [N, S, K] unsigned and weights [N, S, K] float32, each code summing to 1.
    """
    generator = torch.Generator().manual_seed(0)
    low, high = means.amin(0), means.amax(0)
    indices = torch.empty(len(means), n_levels, k, dtype=index_dtype(n_atoms), device=means.device)
    for level in range(n_levels):
        count = CELLS[min(level, len(CELLS) - 1)]
        centres = low + torch.rand(count, 3, generator=generator).to(means.device) * (high - low)
        atoms = torch.rand(count, n_atoms, generator=generator).argsort(1)[:, :k]
        atoms = atoms.to(means.device, index_dtype(n_atoms))
        for rows in torch.arange(len(means), device=means.device).split(1 << 18):
            indices[rows, level] = atoms[torch.cdist(means[rows], centres).argmin(1)]
    weights = torch.rand(len(means), n_levels, k, generator=generator).to(means.device) + 1e-3
    return indices, (weights / weights.sum(2, keepdim=True)).sort(2, descending=True).values
