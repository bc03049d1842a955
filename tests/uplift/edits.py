"""Edits of splats for tests."""

from __future__ import annotations

import torch

from scoup.scene import Gaussians


def joined(*parts: Gaussians) -> Gaussians:
    """One splat after the other."""
    names = ("means", "quats", "scales", "opacities", "sh")
    return Gaussians(*(torch.cat([getattr(part, name) for part in parts]) for name in names))
