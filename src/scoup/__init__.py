"""SCOUP: language fields for trained 3D Gaussian Splatting scenes by sparse code uplifting.

Names are loaded when first used, so that ``import scoup`` stays fast and needs neither torch nor a GPU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

_HOMES = {
    "Gaussians": "scoup.gaussians",
    "Camera": "scoup.cameras",
    "Cameras": "scoup.cameras",
    "RegionMap": "scoup.regions",
    "Regions": "scoup.regions",
    "SparseCodes": "scoup.codes",
    "ScoupError": "scoup.errors",
    "ScoupWarning": "scoup.errors",
    "load_gaussians": "scoup.io",
    "save_gaussians": "scoup.io",
    "load_cameras": "scoup.io",
    "load_regions": "scoup.io",
    "Codebook": "scoup.coding",
    "fit_codes": "scoup.coding",
    "look": "scoup.raster",
    "RegionSums": "scoup.uplift.region_sums",
    "region_sums": "scoup.uplift.taking",
    "vote": "scoup.uplift.vote",
    "LanguageField": "scoup.field",
    "build": "scoup.uplift.build",
    "update": "scoup.uplift.update",
    "TextEncoder": "scoup.text",
    "localize": "scoup.query",
    "segment": "scoup.query",
    "select": "scoup.query",
}

__all__ = ["__version__", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from scoup.cameras import Camera as Camera
    from scoup.cameras import Cameras as Cameras
    from scoup.codes import SparseCodes as SparseCodes
    from scoup.coding import Codebook as Codebook
    from scoup.coding import fit_codes as fit_codes
    from scoup.errors import ScoupError as ScoupError
    from scoup.errors import ScoupWarning as ScoupWarning
    from scoup.field import LanguageField as LanguageField
    from scoup.gaussians import Gaussians as Gaussians
    from scoup.io import load_cameras as load_cameras
    from scoup.io import load_gaussians as load_gaussians
    from scoup.io import load_regions as load_regions
    from scoup.io import save_gaussians as save_gaussians
    from scoup.query import localize as localize
    from scoup.query import segment as segment
    from scoup.query import select as select
    from scoup.raster import look as look
    from scoup.regions import RegionMap as RegionMap
    from scoup.regions import Regions as Regions
    from scoup.text import TextEncoder as TextEncoder
    from scoup.uplift.build import build as build
    from scoup.uplift.region_sums import RegionSums as RegionSums
    from scoup.uplift.taking import region_sums as region_sums
    from scoup.uplift.update import update as update
    from scoup.uplift.vote import vote as vote


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scoup' has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
