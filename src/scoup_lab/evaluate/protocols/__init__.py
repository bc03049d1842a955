"""The protocols of published data sets, one module each; what those of pixels have in common, and what is counted of
points."""

from __future__ import annotations

from scoup.base import Registry
from scoup_lab.evaluate.protocols import lerf_ovs, mipnerf360, threed_ovs
from scoup_lab.evaluate.protocols.pixels import PixelProtocol

PIXELS = Registry(
    "protocol",
    "scoup_lab.protocols",
    PixelProtocol,
    (lerf_ovs.PROTOCOL, threed_ovs.PROTOCOL, mipnerf360.PROTOCOL),
)
"""By name."""
