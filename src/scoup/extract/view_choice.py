"""How much each candidate camera shows of a splat, and the fewest that show it from several directions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from scoup.extract.view_candidates import Matter
from scoup.raster import PreparedGaussians, project, render_channels
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians

MOST_COUNTED = 20_000  # Gaussians that are counted when views are compared
SIDE = 160  # pixels of the longer side of a cheap render
FIRM = (
    0.12  # standard deviation of depth along a ray, as a share of depth, from which there is no clear surface
)
NEAR = 0.12  # of the radius of the scene: what is nearer is too near
BLURRED = 0.06  # of the width of the image: standard deviation of a Gaussian that is too large to be sharp
DIRECTIONS = 3  # from which each Gaussian is to be seen


@dataclass(frozen=True, eq=False)
class Scores:
    """What candidate cameras show of M counted Gaussians."""

    cameras: list[Camera]
    shown: Tensor
    """[V, M] float16, how well each Gaussian is shown, 0..1."""
    direction: Tensor
    """[V, M] uint8, the sector of directions from which it is seen."""
    quality: Tensor
    """[V] float32, of each view as a picture, 0..1."""

    @classmethod
    def of(cls, cameras: list[Camera], found: Sequence[tuple[Tensor, Tensor, float]]) -> Scores:
        """Return the scores that ``ViewScorer.score`` gave of each camera."""
        shown, direction, quality = zip(*found, strict=True)
        return cls(cameras, torch.stack(shown).half(), torch.stack(direction), torch.tensor(quality))

    @property
    def positions(self) -> Tensor:
        """[V, 3] float32 of the cameras."""
        return torch.stack([camera.position for camera in self.cameras]).float()

    @classmethod
    def joined(cls, parts: Sequence[Scores]) -> Scores:
        """Return the scores of the cameras of all parts."""
        return cls(
            [camera for part in parts for camera in part.cameras],
            torch.cat([part.shown for part in parts]),
            torch.cat([part.direction for part in parts]),
            torch.cat([part.quality for part in parts]),
        )


def prepared_order(prepared: PreparedGaussians, rows: Tensor) -> Tensor:
    """Return where ``rows`` of the scene are among the prepared Gaussians."""
    if prepared.order is None:
        return rows
    places = torch.empty_like(prepared.order)
    places[prepared.order] = torch.arange(len(places))
    return places[rows]


@dataclass(frozen=True, eq=False)
class ViewScorer:
    """Scores cameras by cheap renders."""

    prepared: PreparedGaussians
    counted: Tensor
    """[M] int64, rows of the prepared Gaussians that count."""
    sizes: Tensor
    """[N] float32, standard deviation of each along its middle axis."""
    full_size: float
    """Standard deviation at which all matter side by side would fill an image, as a share of its width."""
    sectors: Tensor
    """[B, 3] float32 unit vectors, middles of the sectors of directions."""
    radius: float
    """Of the scene."""

    @classmethod
    def of(cls, prepared: PreparedGaussians, matter: Matter) -> ViewScorer:
        gaussians: Gaussians = prepared.gaussians
        step = -(-len(matter.rows) // MOST_COUNTED)
        counted = prepared_order(prepared, matter.rows[::step])
        sizes = gaussians.scales.sort(1).values[:, 1].contiguous()
        full_size = (0.75 / (4 * math.pi * len(matter.rows))) ** 0.5
        return cls(prepared, counted, sizes, full_size, _sectors(), matter.radius)

    @property
    def means(self) -> Tensor:
        """[M, 3] of the counted Gaussians."""
        return self.prepared.gaussians.means[self.counted]

    def score(self, camera: Camera) -> tuple[Tensor, Tensor, float]:
        """Return how well a camera shows each counted Gaussian [M], from which sector [M], and its quality."""
        factor = SIDE / max(camera.width, camera.height)
        small = camera.resized(round(camera.width * factor), round(camera.height * factor))
        gaussians = self.prepared.gaussians
        rotation, shift = small.viewmat[:3, :3].float(), small.viewmat[:3, 3].float()
        depth = gaussians.means @ rotation[2] + shift[2]
        near = NEAR * self.radius
        blur = self.sizes * (small.fx / small.width) / depth.clamp(min=1e-6)
        values = torch.stack([depth, depth * depth, (depth < near).float(), (blur > BLURRED).float()], 1)
        image, alpha = render_channels(project(self.prepared, small), torch.nan_to_num(values, 0, 0, 0))
        mean = image[..., 0] / alpha.clamp(min=1e-6)
        spread = (image[..., 1] / alpha.clamp(min=1e-6) - mean * mean).clamp(min=0).sqrt()
        solid = alpha > 0.5
        firm = solid & (spread < FIRM * mean)
        bad = image[..., 2] + image[..., 3]
        covered = float(alpha.mean())
        share = float(firm.float().mean()) / max(float((alpha > 0.05).float().mean()), 1e-6)
        quality = share**2 * max(0.0, 1 - 4 * float(image[..., 2].mean()))
        quality *= max(0.0, 1 - 2 * float(image[..., 3].mean())) * min(1.0, covered / 0.25)
        return *self._shown(small, depth, mean, spread, firm & (bad < 0.3)), quality

    def _shown(
        self, camera: Camera, depth: Tensor, mean: Tensor, spread: Tensor, clear: Tensor
    ) -> tuple[Tensor, Tensor]:
        gaussians, rows = self.prepared.gaussians, self.counted
        means, z = gaussians.means[rows], depth[rows]
        seen = means @ camera.viewmat[:3, :3].float().T + camera.viewmat[:3, 3].float()
        x = (camera.fx * seen[:, 0] / z.clamp(min=1e-6) + camera.cx).floor()
        y = (camera.fy * seen[:, 1] / z.clamp(min=1e-6) + camera.cy).floor()
        inside = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        pixel = torch.where(inside, y * camera.width + x, torch.zeros_like(x)).long()
        there = mean.flatten()[pixel]
        reach = spread.flatten()[pixel].clamp(max=0.1 * there) + 0.02 * there + self.sizes[rows]
        visible = inside & clear.flatten()[pixel] & (z < there + reach)
        sizes = self.sizes[rows]
        shares = sizes.clamp(min=float(sizes.median())) * (camera.fx / camera.width) / z.clamp(min=1e-6)
        sharp = (shares / self.full_size).clamp(max=1) ** 2 * (2 - shares / BLURRED).clamp(0, 1)
        way = camera.position.float() - means
        direction = (way @ self.sectors.T).argmax(1).to(torch.uint8)
        return visible * sharp, direction


def choose_views(
    scores: Scores, fronts: Tensor, count: int | None, least_gain: float, most: int
) -> list[int]:
    """Return the views that show the most, one after the other, by marginal gain.

    A Gaussian that is shown from directions b with qualities q_b is worth sqrt(min(sum of q_b, 3)): a submodular
    function of the views, for which the greedy choice is within 1 - 1/e of the best (Nemhauser et al. 1978).

    Args:
        fronts: [V, M] bool, whether a view sees the front of a Gaussian.
        count: views to choose; by default as many as gain at least ``least_gain`` of the first.
        most: views, where ``count`` is None.
    """
    worth = scores.shown.float() * scores.quality[:, None] ** 2 * fronts
    n_sectors = int(scores.direction.max()) + 1
    state = torch.zeros(worth.shape[1], n_sectors)
    chosen: list[int] = []
    first = 0.0
    bound = [float("inf")] * len(worth)
    while len(chosen) < min(count or most, len(worth)):
        total = state.sum(1)
        before = total.clamp(max=DIRECTIONS).sqrt()
        best, gain = -1, 0.0
        for view in sorted(range(len(worth)), key=lambda view: -bound[view]):
            if bound[view] <= gain:
                break
            if view in chosen:
                continue
            sector = scores.direction[view].long()[:, None]
            more = (worth[view] - state.gather(1, sector)[:, 0]).clamp(min=0)
            bound[view] = float(((total + more).clamp(max=DIRECTIONS).sqrt() - before).sum())
            if bound[view] > gain:
                best, gain = view, bound[view]
        first = first or gain
        if best < 0 or (count is None and gain < least_gain * first):
            break
        chosen.append(best)
        bound[best] = -1.0
        sector = scores.direction[best].long()[:, None]
        state.scatter_reduce_(1, sector, worth[best][:, None], "amax")
    return chosen


def front_sides(scores: Scores, means: Tensor) -> Tensor:
    """Return [V, M] bool: whether each view sees the side of a Gaussian from which the views that show the most see it.

    Args:
        means: [M, 3] of the Gaussians.
    """
    richness = scores.quality * scores.shown.float().mean(1)
    mean, total = torch.zeros_like(means), torch.zeros(len(means))
    for view, place in enumerate(scores.positions):
        weight = richness[view] * scores.shown[view].float()
        mean += weight[:, None] * normalize(place - means, dim=1)
        total += weight
    mean /= total.clamp(min=1e-9)[:, None]
    length = mean.norm(dim=1)
    return torch.stack(
        [
            ((normalize(place - means, dim=1) * mean).sum(1) > -0.1 * length) | (length < 0.2)
            for place in scores.positions
        ]
    )


def _sectors() -> Tensor:
    """Return [20, 3]: directions spread evenly over the sphere, the corners of a dodecahedron."""
    golden = (1 + 5**0.5) / 2
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    for first in (-1, 1):
        for second in (-1, 1):
            near, far = first / golden, second * golden
            corners += [(0, near, far), (near, far, 0), (far, 0, near)]
    return normalize(torch.tensor(corners, dtype=torch.float32), dim=1)
