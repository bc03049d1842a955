"""Rooms of box-shaped clouds, seen by named cameras: every thing and relation in them is known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from query.conftest import random_vectors
from scoup.field import NO_THING, FieldInfo
from scoup.models import CANONICAL_PHRASES
from scoup.query.language_field import LanguageField
from scoup.scene import Camera, Cameras
from support import gaussians_at, things_of, unit

DIM = 32
CLUTTER = tuple(f"clutter {number}" for number in range(6))  # things like any other, far behind
ABSENT = "unicorn"
FRONT = Camera.look_at((0, -5, 1), (0, 0, 1), "front.png", 64, 48, 50)
BACK = Camera.look_at((0, 5, 1), (0, 0, 1), "back.png", 64, 48, 50)


@dataclass(frozen=True)
class Box:
    """A cloud that fills a box; z is up."""

    name: str
    middle: tuple[float, float, float]
    size: tuple[float, float, float]

    def cloud(self, steps: int = 6, is_rough: bool = False) -> Tensor:
        ticks = (torch.arange(steps) + 0.5) / steps - 0.5
        grid = torch.stack(torch.meshgrid(ticks, ticks, ticks, indexing="ij"), -1).reshape(-1, 3)
        if is_rough:  # all clouds in the same way
            grid = grid + (torch.rand(grid.shape, generator=torch.Generator().manual_seed(0)) - 0.5) / steps
        return torch.tensor(self.middle) + grid * torch.tensor(self.size)


ROOM = (
    Box("table", (0, 0, 0.95), (4, 2, 0.1)), Box("mug", (-1, -0.5, 1.1), (0.2, 0.2, 0.2)),
    Box("mug", (1, 0.5, 1.15), (0.3, 0.3, 0.3)), Box("laptop", (0, 0, 1.15), (0.4, 0.3, 0.3)),
    Box("lamp", (0, 0, 2), (0.3, 0.3, 0.3)), Box("ball", (1, 0, 0.2), (0.3, 0.3, 0.3)),
    Box("bowl", (-1.5, 0.5, 1.15), (0.4, 0.4, 0.3)), Box("apple", (-1.5, 0.5, 1.15), (0.1, 0.1, 0.1)),
    Box("pen", (0.35, 0, 1.03), (0.06, 0.06, 0.06)),
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Similarity:
    """x -> scale * turn @ x + shift."""

    turn: Tensor
    scale: float
    shift: Tensor


def planted_room(
    boxes: Sequence[Box] = ROOM,
    cameras: Sequence[Camera] = (FRONT, BACK),
    moved: Similarity | None = None,
    has_things: bool = True,
    is_rough: bool = False,
) -> LanguageField:
    """A field of boxes and clutter; thing n is box n. It knows the words for all of them, and ``ABSENT``."""
    clutter = [Box(name, (3.0 * place - 9, 40, 1), (1, 1, 1)) for place, name in enumerate(CLUTTER)]
    every = [*boxes, *clutter]
    names = list(dict.fromkeys(box.name for box in every))
    means = torch.cat([box.cloud(is_rough=is_rough) for box in every]).double()
    size = len(means) // len(every)
    if moved is not None:
        means = moved.scale * means @ moved.turn.T + moved.shift
        cameras = [each.moved(moved.turn, moved.shift / moved.scale, moved.scale) for each in cameras]
    gaussians = gaussians_at(means, 0.01 * (moved.scale if moved else 1.0))
    common = random_vectors(1, DIM, seed=5)
    words = [*names, ABSENT, *(f"word {number}" for number in range(30)), *CANONICAL_PHRASES]
    vectors = unit(common + random_vectors(len(words), DIM, seed=6))
    vectors[len(names)] = unit(common[0] - vectors[: len(names)].mean(0))  # like no word for what is there
    of_box = torch.tensor([names.index(box.name) for box in every])
    owner = torch.arange(len(every)).repeat_interleave(size)
    things = things_of(owner[:, None], torch.zeros(len(every)), vectors[of_box])
    return LanguageField(
        of_box[owner].to(torch.uint8)[:, None, None],
        torch.ones(len(means), 1, 1),
        vectors[: len(names)][None],
        FieldInfo(("m",), "", gaussians.fingerprint(), len(means)),
        gaussians,
        cameras=Cameras(cameras),
        thing_table=things if has_things else None,
        words=dict(zip(words, vectors, strict=True)),
    )


def with_whole(parts: LanguageField, members: Sequence[int]) -> tuple[LanguageField, int]:
    """Return a room with a second, coarser level, at which some things are one; and the number of that one."""
    fine = parts.thing_table
    assert fine is not None
    whole, inside = len(fine), torch.tensor(members)
    owners = torch.where(torch.isin(fine.owners, inside), whole, NO_THING).int()
    more = {name: getattr(fine, name)[:1] for name in ("agreement", "n_regions", "mass", "stability")}
    table = replace(
        fine,
        owners=torch.cat([fine.owners, owners], 1),
        levels=torch.cat([fine.levels, torch.ones(1, dtype=torch.uint8)]),
        parents=torch.where(torch.isin(torch.arange(whole + 1), inside), whole, NO_THING).int(),
        embeddings=torch.cat([fine.embeddings, unit(fine.embeddings[inside].float().sum(0)).half()[None]]),
        **{name: torch.cat([getattr(fine, name), column]) for name, column in more.items()},
    )
    field = parts.changed(
        parts.gaussians,
        code_indices=parts.code_indices.expand(-1, 2, -1).contiguous(),
        code_weights=parts.code_weights.expand(-1, 2, -1).contiguous(),
        codebook=parts.codebook.expand(2, -1, -1).contiguous(),
        info=replace(parts.info, levels=("s", "m")),
        thing_table=table,
    )
    return field, whole
