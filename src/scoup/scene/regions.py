"""Region maps: the region of each pixel, and the embedding of each region."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup.base import InputError, UnknownNameError, brief, card, counted, listed
from scoup.scene.directions import unit_rows

INTEGERS = (torch.int32, torch.int64, torch.int16, torch.int8, torch.uint8)  # types of labels
LEVELS = ("s", "m", "l")  # subparts, parts, wholes: the three masks that SAM proposes for a point
LEAST_EMBEDDING = 64  # dimensions of a model's; fewer are codes of an autoencoder, or of instances
_SURE_CODES = 8  # dimensions, below which nobody has embeddings


@dataclass(frozen=True, eq=False)
class RegionMap:
    """The regions of one view at one level.

    Tensors and numpy arrays are accepted; labels of any integer type, embeddings of any floating-point type and any
    norm.

    Raises:
        InputError: a label has no embedding, a value is not finite, or a shape or dtype is wrong.

    Example:
        >>> labels = torch.tensor([[-1, 0], [1, 1]])  # a pixel of no region, one of region 0, two of region 1
        >>> found = scoup.RegionMap(labels, torch.eye(2))
        >>> found.resized(4, 4).labels.shape
        torch.Size([4, 4])
    """

    labels: Tensor
    """[H, W] int32, the row of each pixel's region in ``embeddings``; -1 where there is no region."""
    embeddings: Tensor
    """[R, D] float32, one row per region, scaled to unit norm (a zero row means "unknown")."""

    __repr__ = brief

    def __post_init__(self) -> None:
        labels = torch.as_tensor(self.labels)
        if labels.dim() != 2 or labels.dtype not in INTEGERS:
            raise InputError(
                f"region labels must be integers [H, W], got {labels.dtype} {list(labels.shape)}"
            )
        embeddings = unit_rows(self.embeddings, "region embeddings")
        if labels.numel():
            low, high = int(labels.min()), int(labels.max())
            if low < -1 or high >= len(embeddings):
                raise InputError(
                    f"region labels run from {low} to {high}, but there are {len(embeddings)} embeddings"
                )
        object.__setattr__(self, "labels", labels.to(torch.int32))
        object.__setattr__(self, "embeddings", embeddings)

    def resized(self, width: int, height: int) -> RegionMap:
        """Return the same regions at another image size (``resize_labels``)."""
        return RegionMap(resize_labels(self.labels, width, height), self.embeddings)


def resize_labels(labels: Tensor, width: int, height: int) -> Tensor:
    """Resample labels [..., H, W] to [..., height, width]: each new pixel gets the label under its centre."""
    rows, columns = labels.shape[-2:]
    if (columns, rows) == (width, height):
        return labels
    take_rows = (
        ((torch.arange(height, dtype=torch.float64) + 0.5) * (rows / height)).long().clamp_(max=rows - 1)
    )
    take_columns = (
        ((torch.arange(width, dtype=torch.float64) + 0.5) * (columns / width)).long().clamp_(max=columns - 1)
    )
    return labels[..., take_rows, :][..., take_columns]


class Regions:
    """The region maps of all views and levels, loaded when needed: only one has to be in memory at a time.

    Args:
        levels: level names, fine to coarse.
        view_names: names of the cameras of views with regions, in order.
        load: ``load(view_name, level)`` returns a map; called each time one is needed.
        load_embeddings: ``load_embeddings(view_name, level)`` returns the embeddings [R, D] alone, if that is cheaper.
        load_labels: ``load_labels(view_name)`` returns the labels of all levels alone, [S, H, W] int32, checked against
            the number of embeddings, if that is cheaper.

    Example:
        >>> regions = scoup.load_regions("scene", scoup.load_cameras("scene"))
        >>> regions.levels
        ('s', 'm', 'l')
        >>> "view_00.png" in regions
        True
    """

    def __init__(
        self,
        levels: Iterable[str],
        view_names: Iterable[str],
        load: Callable[[str, str], RegionMap],
        load_embeddings: Callable[[str, str], Tensor] | None = None,
        load_labels: Callable[[str], Tensor] | None = None,
    ) -> None:
        self.levels = tuple(levels)
        self.view_names = tuple(view_names)
        self._names = frozenset(self.view_names)
        self._load = load
        self._load_embeddings = load_embeddings
        self._load_labels = load_labels

    @classmethod
    def from_maps(cls, maps: Mapping[str, Mapping[str, RegionMap]]) -> Regions:
        """Return regions in memory, ``{view name: {level: RegionMap}}``.

        Raises:
            InputError: two views have different levels.
        """
        levels = tuple(next(iter(maps.values()))) if maps else LEVELS
        for name, by_level in maps.items():
            if tuple(by_level) != levels:
                raise InputError(
                    f"view {name!r} has levels {list(by_level)}, the first view has {list(levels)}"
                )
        return cls(levels, maps, lambda name, level: maps[name][level])

    def __repr__(self) -> str:
        return f"Regions({counted(len(self), 'view')}, levels {', '.join(self.levels)}: {listed(self.view_names, 4)})"

    def _repr_html_(self) -> str:
        from scoup.scene.previews import labels_preview

        facts = {"levels": ", ".join(self.levels), "views": listed(self.view_names, 4)}
        picture = None
        if len(self):
            name, level = self.view_names[0], self.levels[len(self.levels) // 2]
            shown = self.load(name, level)
            facts["picture"] = (
                f"{name}, level {level}: {len(shown.embeddings)} regions of {shown.embeddings.shape[1]} d"
            )
            picture = labels_preview(shown.labels)
        return card(f"Regions of {counted(len(self), 'view')}", facts, picture)

    def __len__(self) -> int:
        return len(self.view_names)

    def __contains__(self, view_name: str) -> bool:
        return view_name in self._names

    def load(self, view_name: str, level: str) -> RegionMap:
        """Return the region map of one view and level.

        Raises:
            UnknownNameError: there is no such view or level.
        """
        self._check(view_name, level)
        return self._load(view_name, level)

    def load_labels(self, view_name: str, width: int, height: int) -> Tensor:
        """Return the labels of all levels of a view at one image size, [S, height, width] int32. Do not change them in
        place.

        Embeddings are not read if labels can be loaded without them.

        Raises:
            UnknownNameError: there is no such view.
            InputError: the loaded labels are not one label map a level.
        """
        self._check(view_name)
        if self._load_labels is None:
            maps = (self._load(view_name, level).labels for level in self.levels)
            return torch.stack([resize_labels(labels, width, height) for labels in maps])
        labels = self._load_labels(view_name)
        if labels.dim() != 3 or len(labels) != len(self.levels) or labels.dtype != torch.int32:
            raise InputError(
                f"region labels must be int32 [{len(self.levels)}, H, W], got {labels.dtype} {list(labels.shape)}"
            )
        return resize_labels(labels, width, height)

    def load_view(self, view_name: str, width: int, height: int) -> tuple[Tensor, list[Tensor]]:
        """Return all levels of a view at one image size: labels [S, height, width] int32, embeddings S x [R_s, D]."""
        labels = self.load_labels(view_name, width, height)
        return labels, [self.load_embeddings(view_name, level) for level in self.levels]

    def load_embeddings(self, view_name: str, level: str) -> Tensor:
        """Return the embeddings [R, D] float32 of one view and level, of unit norm.

        Raises:
            InputError: they are not [R, D], or not finite.
        """
        self._check(view_name, level)
        if self._load_embeddings is not None:
            return unit_rows(self._load_embeddings(view_name, level), f"region embeddings of {view_name}")
        return self._load(view_name, level).embeddings

    def embeddings(self, level: str) -> tuple[Tensor, dict[str, slice]]:
        """Return all embeddings of a level stacked in the order of the views, [R, D] float32, and the rows of each
        view.

        Raises:
            InputError: there are no views, or embeddings differ in size.
        """
        blocks: list[Tensor] = []
        rows: dict[str, slice] = {}
        start = 0
        for name in self.view_names:
            block = self.load_embeddings(name, level)
            rows[name] = slice(start, start + len(block))
            start += len(block)
            blocks.append(block)
        if not blocks:
            raise InputError("there are no regions: no view has a region map")
        dimensions = {block.shape[1] for block in blocks}
        if len(dimensions) > 1:
            raise InputError(f"region embeddings of different sizes {sorted(dimensions)}: they mix models")
        return torch.cat(blocks), rows

    def select(self, view_names: Iterable[str]) -> Regions:
        """Return the regions of these views, in their order.

        Raises:
            UnknownNameError: a view has no regions.
        """
        names = tuple(view_names)
        for name in names:
            self._check(name)
        return Regions(self.levels, names, self._load, self._load_embeddings, self._load_labels)

    def _check(self, view_name: str, level: str | None = None) -> None:
        if view_name not in self:
            raise UnknownNameError("view with regions", view_name, self.view_names)
        if level is not None and level not in self.levels:
            raise UnknownNameError("level", level, self.levels)


def codes_problem(dim: int) -> str:
    """Return why vectors of so few dimensions are not embeddings, and the remedy; "" if they are."""
    if dim >= _SURE_CODES:
        return ""
    return (
        f"the regions have {dim} numbers each, codes of LangSplat's autoencoder and not embeddings; decode them with "
        "scoup convert (its best_ckpt.pth as `autoencoder`), and use the result"
    )


@dataclass(frozen=True, eq=False)
class Detections:
    """Detections of a model in one photograph: M boxes, each for one of several texts."""

    texts: Tensor  # [M] int64, position of the text
    scores: Tensor  # [M] float32, 0 to 1
    boxes: Tensor  # [M, 4] float32, x0, y0, x1, y1 in pixels
    size: tuple[int, int]  # width and height of the photograph
    masks: Tensor | None = None  # [M, H, W] boolean; None of models that find boxes

    __repr__ = brief
