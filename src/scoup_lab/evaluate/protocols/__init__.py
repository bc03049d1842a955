"""The protocols of published data sets, one module each; what pixels and what points have in common."""

from __future__ import annotations

from scoup_lab.evaluate.protocols import lerf_ovs, mipnerf360, ref_lerf, scannet, scenesplat, threed_ovs
from scoup_lab.evaluate.protocols.pixels import PixelProtocol
from scoup_lab.evaluate.protocols.points import PointProtocol

PIXELS: dict[str, PixelProtocol] = {
    module.PROTOCOL.name: module.PROTOCOL for module in (lerf_ovs, threed_ovs, mipnerf360, ref_lerf)
}
POINTS: dict[str, PointProtocol] = {module.PROTOCOL.name: module.PROTOCOL for module in (scannet, scenesplat)}
"""By name."""
