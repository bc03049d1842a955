"""The protocols of published data sets, one module each; what those of pixels have in common, and what is counted of
points."""

from __future__ import annotations

from scoup_lab.evaluate.protocols import lerf_ovs, mipnerf360, threed_ovs
from scoup_lab.evaluate.protocols.pixels import PixelProtocol

PIXELS: dict[str, PixelProtocol] = {
    module.PROTOCOL.name: module.PROTOCOL for module in (lerf_ovs, threed_ovs, mipnerf360)
}
"""By name."""
