"""The region sums of a view, as a rasteriser makes them, become the entries that are kept."""

from __future__ import annotations

import torch
from torch import Tensor

from scoup.raster import ViewSums
from scoup.uplift.storage.entries import Entries, pack


class Packer:
    """Packs views whose Gaussians are in any order; ``order`` as for ``RegionSums``."""

    def __init__(self, order: Tensor) -> None:
        self._order = order
        self._place_of: dict[torch.device, Tensor] = {}
        self._same_order: Tensor | None = None

    def entries(self, sums: ViewSums, order: Tensor | None) -> list[Entries]:
        """Return the entries of a view; arguments as for ``RegionSums.append``."""
        gaussian, combination, weight = sums.gaussian, sums.combination, sums.weight
        if not self._is_same(order):
            place = self._places(gaussian.device)
            row = gaussian.long() if order is None else order.to(gaussian.device)[gaussian.long()]
            gaussian, by_place = torch.sort(place[row], stable=True)
            combination, weight = combination[by_place], weight[by_place]
        parts = [part.cpu().numpy() for part in (gaussian, combination, weight, sums.table)]
        return pack(parts[0], parts[1], parts[2], parts[3])

    def _is_same(self, order: Tensor | None) -> bool:
        if order is not None and order is not self._same_order and torch.equal(order.cpu(), self._order):
            self._same_order = order  # compared once, not per view
        return order is not None and order is self._same_order

    def _places(self, device: torch.device) -> Tensor:
        """Return [N] int64, the place here of each row of the scene."""
        if device not in self._place_of:
            self._place_of[device] = torch.argsort(self._order).to(device)
        return self._place_of[device]
