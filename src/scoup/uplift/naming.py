"""Names for things: open-vocabulary detections in photographs vote for the things there.

A detection votes for the things that it overlaps, by its score times the overlap: of boxes, or of masks where the model
gives masks. The vote of a text for a thing is the mean over the best views, of those that see the thing; so one view
alone weighs little. A text is as present as the mean of its best scores says. Measured in docs/answers.md.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor

from scoup import raster
from scoup.field import Field, NameTable, ThingTable
from scoup.scene import Camera, Detections, Gaussians
from scoup.uplift import constants

Own = TypeVar("Own", bound=Field)
AT_A_TIME = 64  # things that are rendered together


@dataclass(frozen=True, eq=False)
class ThingsInView:
    """The T things of a scene in one small picture."""

    masks: Tensor  # [T, h, w] boolean, where a thing contributes most of a pixel
    boxes: Tensor  # [T, 4] float32 x0, y0, x1, y1 in its pixels, without the outermost hundredth of the thing's pixels

    @property
    def seen(self) -> Tensor:
        """Return the mask of things with enough pixels, [T] boolean."""
        return self.masks.sum((1, 2)) >= constants.NAMING_PIXELS


def things_in_view(
    gaussians: Gaussians, table: ThingTable, camera: Camera, raster_preset: str
) -> ThingsInView:
    """Return the things as a camera sees them, on the CPU."""
    small = camera.scaled(min(1.0, constants.NAMING_SIDE / max(camera.width, camera.height)))
    projection = raster.project(gaussians, small, raster_preset)
    ones = torch.ones(len(gaussians), 1, device=gaussians.device)
    alpha = raster.render_values(projection, ones)[..., 0].cpu()
    masks = []
    for start in range(0, len(table), AT_A_TIME):
        count = min(AT_A_TIME, len(table) - start)
        values = ones.new_zeros(len(gaussians), count)
        for owners in table.owners.to(values.device).T:
            members = ((owners >= start) & (owners < start + count)).nonzero()[:, 0]
            values[members, owners[members].long() - start] = 1
        shares = raster.render_values(projection, values).permute(2, 0, 1).cpu()
        masks.append(shares > 0.5 * alpha.clamp(min=0.05))
    together = torch.cat(masks) if masks else torch.zeros(0, small.height, small.width, dtype=torch.bool)
    ends = torch.stack([*_ends(together.sum(1)), *_ends(together.sum(2))], 1)
    return ThingsInView(together, ends[:, [0, 2, 1, 3]])


def _ends(counts: Tensor) -> tuple[Tensor, Tensor]:
    """Return start and end of the middle 98 % of pixels counted along one side [T, n], [T] float32 each."""
    below = counts.cumsum(1) / counts.sum(1, keepdim=True).clamp(min=1)
    return (below <= 0.01).sum(1).float(), (below < 0.99).sum(1).float() + 1


def overlaps(hits: Detections, view: ThingsInView) -> Tensor:
    """Return the intersection over union of each detection with each thing, [M, T]; 0 with things that are not seen."""
    height, width = view.masks.shape[1:]
    if hits.masks is None:
        scale = torch.tensor([width / hits.size[0], height / hits.size[1]]).repeat(2)
        ious = box_ious(hits.boxes * scale, view.boxes)
    else:
        masks = torch.nn.functional.interpolate(hits.masks[:, None].float(), (height, width), mode="area")
        detected, things = masks.flatten(1), view.masks.flatten(1).float()
        both = detected @ things.T
        ious = both / (detected.sum(1)[:, None] + things.sum(1) - both).clamp(min=1)
    return torch.where(view.seen, ious, 0.0)


def box_ious(one: Tensor, other: Tensor) -> Tensor:
    """Return the intersection over union of boxes [M, 4] and [T, 4], [M, T]."""
    low, high = torch.maximum(one[:, None, :2], other[:, :2]), torch.minimum(one[:, None, 2:], other[:, 2:])
    both = (high - low).clamp(min=0).prod(2)
    areas = [(boxes[:, 2:] - boxes[:, :2]).prod(1) for boxes in (one, other)]
    return both / (areas[0][:, None] + areas[1] - both).clamp(min=1e-6)


@dataclass(frozen=True, eq=False)
class ViewVotes:
    """The E votes of one photograph on M texts and T things."""

    rows: Tensor  # [E] int64, position of the text
    things: Tensor  # [E] int64
    votes: Tensor  # [E] float32
    seen: Tensor  # [T] boolean, the things that it shows
    tops: Tensor  # [M] float32, the best score of each text

    def of_text(self, row: int) -> ViewVotes:
        """Return the votes of one text, as the only one."""
        chosen = self.rows == row
        rows = torch.zeros_like(self.rows[chosen])
        return ViewVotes(rows, self.things[chosen], self.votes[chosen], self.seen, self.tops[row : row + 1])


def votes_in_view(view: ThingsInView, hits: Detections, n_texts: int) -> ViewVotes:
    """Return the votes of the detections in one photograph, the best of each text for each thing."""
    count = max(1, len(view.masks))
    ious = overlaps(hits, view)
    row, thing = (ious >= constants.NAMING_IOU).nonzero(as_tuple=True)
    keys, inverse = (hits.texts[row] * count + thing).unique(return_inverse=True)
    votes = torch.zeros(len(keys)).scatter_reduce_(0, inverse, hits.scores[row] * ious[row, thing], "amax")
    tops = torch.zeros(n_texts).scatter_reduce_(0, hits.texts, hits.scores, "amax")
    return ViewVotes(keys // count, keys % count, votes, view.seen, tops)


def count_votes(texts: Sequence[str], views: Sequence[ViewVotes]) -> NameTable:
    """Return the names that the votes of V >= 1 photographs give to things."""
    seen_in = torch.stack([view.seen for view in views]).sum(0)
    count = max(1, len(seen_in))
    keys = torch.cat([view.rows * count + view.things for view in views])
    key, vote = _sums_of_best(keys, torch.cat([view.votes for view in views]))
    thing = key % count
    votes = vote / seen_in[thing].clamp(2, constants.BEST_VIEWS) if len(thing) else vote
    scores = torch.stack([view.tops for view in views])  # [V, M]
    best = scores.sort(0, descending=True).values[: constants.BEST_SCORES].mean(0)
    presence = best / (best + constants.EVEN_SCORE)
    return NameTable(tuple(texts), presence, (key // count).int(), thing.int(), votes)


def name_things(
    gaussians: Gaussians,
    table: ThingTable,
    views: Iterable[tuple[Camera, Detections]],
    texts: Sequence[str],
    raster_preset: str = "inria",
) -> NameTable:
    """Let detections in V >= 1 photographs, which count the texts as ``texts`` does, vote for the things of a scene.
    All texts were looked for in all of the photographs."""
    counted = [
        votes_in_view(things_in_view(gaussians, table, camera, raster_preset), hits, len(texts))
        for camera, hits in views
    ]
    return count_votes(texts, counted)


def name_field(field: Own, texts: Sequence[str], views: Sequence[tuple[Camera, Detections]]) -> Own:
    """Return a field with things named by detections of texts in photographs; the field itself where it has no things,
    or there are no views."""
    table = field.thing_table
    if table is None or not views:
        return field
    return field.with_names(name_things(field.gaussians, table, views, texts, field.raster_preset))


def _sums_of_best(keys: Tensor, votes: Tensor) -> tuple[Tensor, Tensor]:
    """Return the different keys, rising, and the sum of the ``BEST_VIEWS`` largest votes of each."""
    order = votes.argsort(descending=True, stable=True)
    order = order[keys[order].argsort(stable=True)]
    different, counts = keys[order].unique_consecutive(return_counts=True)
    first = (counts.cumsum(0) - counts).repeat_interleave(counts)
    counted = torch.arange(len(order)) - first < constants.BEST_VIEWS
    of_key = torch.arange(len(different)).repeat_interleave(counts)
    return different, torch.zeros(len(different)).index_add_(0, of_key[counted], votes[order][counted])
