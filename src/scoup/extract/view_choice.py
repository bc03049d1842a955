"""Scores of candidate cameras of a splat, and the fewest that show it from several directions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import normalize

from scoup.extract import constants
from scoup.extract.view_candidates import Matter
from scoup.raster import PreparedGaussians, project, render_channels
from scoup.scene import Camera, Gaussians, rotation_matrices

MOST_COUNTED = 20_000  # Gaussians that are counted when views are compared
SIDE = 160  # pixels of the longer side of a cheap render
FARTHEST = 1e15  # depth in any unit, whose square is in range
_TINY = torch.finfo(torch.float32).tiny  # in any unit: only zeros are below


@dataclass(frozen=True, eq=False)
class Scores:
    """The Gaussians, of M counted ones, that candidate cameras show, and the quality of their pictures."""

    cameras: list[Camera]
    shown: Tensor  # [V, M] float16, how well each Gaussian is shown, 0..1
    direction: Tensor  # [V, M] uint8, the sector of directions from which it is seen
    pictures: Tensor
    """[V, 3] float32. Opaque: share of the pixels that show something which show nothing behind it, less what is too
    near or blurred, 0..1. Filled: mean alpha. Elongation: mean over the pixels of the logarithm of how long the
    Gaussians are along the ray, by across it."""

    @classmethod
    def joined(cls, parts: Sequence[Scores]) -> Scores:
        """Return the scores of the cameras of all parts."""
        shown, direction, pictures = (
            torch.cat([getattr(item, name) for item in parts]) for name in ("shown", "direction", "pictures")
        )
        return cls([camera for item in parts for camera in item.cameras], shown, direction, pictures)

    @property
    def positions(self) -> Tensor:
        """[V, 3] float32 of the cameras."""
        return torch.stack([camera.position for camera in self.cameras]).float()

    def worth(self) -> Tensor:
        """Return [V, M] float32, how well each view shows each Gaussian, 0..1, by ``shown`` and by the picture.

        Training makes Gaussians flat towards the cameras that saw them, and leaves them long along the rays of others:
        where a view finds them long, no camera looked. Views into emptiness lose too, by the fullest view of the same
        Gaussian: around the neck of a guitar all views are empty.
        """
        opaque, filled, elongation = self.pictures.T
        solid = (opaque / opaque.quantile(0.98).clamp(min=1e-6)).clamp(max=1) ** constants.STRICT
        full = (filled / filled.quantile(0.95).clamp(min=1e-6)).clamp(max=1)
        good = elongation[solid * full**constants.FULL > 0.3]
        facing = good.quantile(0.05) if len(good) else elongation.min()
        turned = (elongation - facing - constants.TURNED).clamp(min=0) / constants.SPAN
        clear = (solid * torch.exp(-(turned**2)))[:, None]
        shown = self.shown.float()
        fullest = (shown / shown.amax(0).clamp(min=1e-6) * clear * full[:, None]).amax(0)
        relative = (full[:, None] / fullest.clamp(min=constants.LEAST_FULL)).clamp(max=1)
        return shown * (relative**constants.FULL * clear + constants.NO_QUALITY)


@dataclass(frozen=True, eq=False)
class ViewScorer:
    """Scores cameras by cheap renders."""

    prepared: PreparedGaussians
    counted: Tensor  # [M] int64, rows of the prepared Gaussians that count
    sizes: Tensor  # [N] float32, standard deviation of each along its middle axis
    full_size: float  # standard deviation at which all matter side by side would fill an image, as a share of its width
    sectors: Tensor  # [B, 3] float32 unit vectors, middles of the sectors of directions
    covariances: Tensor  # [6, N] float32: xx, yy, zz, xy, xz, yz
    radius: float  # of the scene
    preset: str  # rasteriser constants

    @classmethod
    def of(cls, prepared: PreparedGaussians, matter: Matter, sectors: Tensor | None = None) -> ViewScorer:
        gaussians: Gaussians = prepared.gaussians
        counted = matter.rows[:: -(-len(matter.rows) // MOST_COUNTED)]
        if prepared.order is not None:
            counted = prepared.order.argsort()[counted]
        sizes = gaussians.scales.sort(1).values[:, 1].contiguous()
        full_size = (0.75 / (4 * math.pi * len(matter.rows))) ** 0.5
        turned = rotation_matrices(gaussians.quats)
        axes = turned * gaussians.scales[:, None, :]
        pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        covariances = torch.stack([(axes[:, one] * axes[:, other]).sum(1) for one, other in pairs])
        sectors = _sectors() if sectors is None else sectors
        return cls(prepared, counted, sizes, full_size, sectors, covariances, matter.radius, matter.preset)

    @property
    def means(self) -> Tensor:
        """[M, 3] of the counted Gaussians."""
        return self.prepared.gaussians.means[self.counted]

    def scores(self, cameras: Iterable[Camera]) -> Scores:
        """Score cameras, one at least."""
        scored = [(camera, *self._score(camera)) for camera in cameras]
        taken, shown, direction, pictures = zip(*scored, strict=True)
        return Scores(list(taken), torch.stack(shown).half(), torch.stack(direction), torch.tensor(pictures))

    def _score(self, camera: Camera) -> tuple[Tensor, Tensor, tuple[float, float, float]]:
        """Return a row of ``Scores``."""
        factor = SIDE / max(camera.width, camera.height)
        small = camera.resized(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))
        gaussians = self.prepared.gaussians
        depth = gaussians.means @ small.viewmat[2, :3].float() + float(small.viewmat[2, 3])
        depth = depth.nan_to_num_(0, 0, 0).clamp_(max=FARTHEST)
        values = torch.empty(len(depth), 5)
        values[:, 0] = depth
        torch.mul(depth, depth, out=values[:, 1])
        values[:, 2] = depth < constants.NEAR * self.radius
        values[:, 3] = self.sizes * (small.fx / small.width / constants.BLURRED) > depth
        values[:, 4] = self._elongation(small)
        image, alpha = render_channels(project(self.prepared, small, self.preset), values)
        mean, square, _, _, elongation = (image / alpha.clamp(min=1e-6)[..., None]).unbind(-1)
        near, blurred = image[..., 2], image[..., 3]
        spread = (square - mean * mean).clamp(min=0).sqrt()
        solid = alpha > 0.5
        shown, direction = self._shown(small, depth, mean, spread, solid & (near + blurred < 0.3))
        opaque = float((alpha > 0.9).sum()) / max(float((alpha > 0.05).sum()), 1.0)
        opaque *= max(0.0, 1 - 4 * float(near.mean())) * max(0.0, 1 - 2 * float(blurred.mean()))
        along = float(elongation[solid].mean()) if bool(solid.any()) else constants.MOST_ELONGATED
        return shown, direction, (opaque, float(alpha.mean()), along)

    def _elongation(self, camera: Camera) -> Tensor:
        """Return [N], the logarithm of the standard deviation along the ray by that across it."""
        x, y, z = (self.prepared.gaussians.means.T - camera.position.float()[:, None]).contiguous()
        xx, yy, zz, xy, xz, yz = self.covariances
        square = (x * x).addcmul_(y, y).addcmul_(z, z).clamp_(min=_TINY)
        along = (x * (xx * x + 2 * (xy * y + xz * z))).addcmul_(y, yy * y + 2 * yz * z).addcmul_(z, zz * z)
        along = along.div_(square).clamp_(min=_TINY)
        across = ((xx + yy + zz).sub_(along)).div_(2).clamp_(min=_TINY)
        logarithm = along.div_(across).log_().mul_(0.5)
        return logarithm.clamp_(-constants.MOST_ELONGATED, constants.MOST_ELONGATED).nan_to_num_(0)

    def _shown(
        self, camera: Camera, depth: Tensor, mean: Tensor, spread: Tensor, clear: Tensor
    ) -> tuple[Tensor, Tensor]:
        gaussians, rows = self.prepared.gaussians, self.counted
        means, z = gaussians.means[rows], depth[rows]
        ahead = z.clamp(min=1e-6 * self.radius)
        seen = means @ camera.viewmat[:3, :3].float().T + camera.viewmat[:3, 3].float()
        x = (camera.fx * seen[:, 0] / ahead + camera.cx).floor()
        y = (camera.fy * seen[:, 1] / ahead + camera.cy).floor()
        inside = (z > 0) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        pixel = torch.where(inside, y * camera.width + x, torch.zeros_like(x)).long()
        there = mean.flatten()[pixel]
        reach = spread.flatten()[pixel].clamp(max=0.1 * there) + 0.02 * there + self.sizes[rows]
        visible = inside & clear.flatten()[pixel] & (z < there + reach)
        sizes = self.sizes[rows]
        shares = (
            sizes.clamp(min=float(sizes.quantile(constants.SMALLEST))) * (camera.fx / camera.width) / ahead
        )
        sharp = (shares / (constants.CLOSE * self.full_size)).clamp(max=1) ** 2 * (
            2 - shares / constants.BLURRED
        ).clamp(0, 1)
        way = camera.position.float() - means
        direction = (way @ self.sectors.T).argmax(1).to(torch.uint8)
        return visible * sharp, direction


def choose_views(
    worth: Tensor,  # [V, M] float32, how well each view shows each Gaussian, 0..1
    direction: Tensor,  # [V, M] uint8, as ``Scores.direction``
    most: int,
    least_gain: float = 0.0,
    there: Iterable[int] = (),
) -> list[int]:
    """Return at most ``most`` views that show the most beside those ``there``, one after the other, by marginal gain.

    A Gaussian that is shown from directions b with qualities q_b is worth sqrt(min(sum of q_b, 10)): a submodular
    function of the views, for which the greedy choice is within 1 - 1/e of the best (Nemhauser et al. 1978).
    """
    n_sectors = int(direction.max()) + 1
    state = torch.zeros(worth.shape[1], n_sectors)
    sectors = direction.long()
    bound = gains_alone(worth)

    def take(view: int) -> None:
        bound[view] = -1.0
        state.scatter_reduce_(1, sectors[view, :, None], worth[view, :, None], "amax")

    for view in there:
        take(view)
    chosen: list[int] = []
    while len(chosen) < most:
        total = state.sum(1)
        before = total.clamp(max=constants.DIRECTIONS).sqrt()
        best, gain = -1, 0.0
        for view in bound.argsort(descending=True, stable=True).tolist():
            if bound[view] <= gain:
                break
            more = (worth[view] - state.gather(1, sectors[view, :, None])[:, 0]).clamp(min=0)
            bound[view] = ((total + more).clamp(max=constants.DIRECTIONS).sqrt() - before).sum()
            if bound[view] > gain:
                best, gain = view, float(bound[view])
        if best < 0 or gain < least_gain:
            break
        chosen.append(best)
        take(best)
    return chosen


def gains_alone(worth: Tensor) -> Tensor:
    """Return [V], what each view gains where there is no other."""
    return worth.clamp(max=constants.DIRECTIONS).sqrt().sum(1)


def clear_worth(scores: Scores, means: Tensor) -> Tensor:
    """Return ``scores.worth`` [V, M] of fronts alone: not of views from behind; means [M, 3] of the Gaussians."""
    fronts = front_sides(scores, means)
    return scores.worth() * fronts * not_from_behind(scores.shown.float(), fronts)[:, None]


def not_from_behind(shown: Tensor, fronts: Tensor) -> Tensor:
    """Return [V], how good views are by the share of what they show whose front they see: few behind walls do."""
    share = (shown * fronts).sum(1) / shown.sum(1).clamp(min=1e-6)
    return (share / share.quantile(0.95).clamp(min=1e-6)).clamp(max=1) ** constants.STRICT


def front_sides(scores: Scores, means: Tensor) -> Tensor:
    """Return [V, M] bool: whether each view sees the side of a Gaussian (at ``means`` [M, 3]) from which the views that
    show the most see it."""
    worth = scores.worth()
    weights = worth * worth.mean(1, keepdim=True)
    mean, total = torch.zeros_like(means), torch.zeros(len(means))
    for view, position in enumerate(scores.positions):
        weight = weights[view]
        mean += weight[:, None] * normalize(position - means, dim=1)
        total += weight
    mean /= total.clamp(min=1e-9)[:, None]
    length = mean.norm(dim=1)
    return torch.stack(
        [
            ((normalize(position - means, dim=1) * mean).sum(1) > -0.1 * length) | (length < 0.2)
            for position in scores.positions
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
