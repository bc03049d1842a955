"""The size of the demo scene that tests share."""

from __future__ import annotations

from typing import Any

SMALL: dict[str, Any] = {"n_gaussians": 30_000, "width": 240, "height": 180, "n_building": 6, "n_held_out": 2}
