"""SCOUP: language fields for trained 3D Gaussian Splatting scenes by sparse code uplifting.

Names are loaded when first used, so that ``import scoup`` stays fast and needs neither torch nor a GPU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

_HOMES = {
    "Gaussians": "scoup.scene",
    "Camera": "scoup.scene",
    "Cameras": "scoup.scene",
    "RegionMap": "scoup.scene",
    "Regions": "scoup.scene",
    "SparseCodes": "scoup.scene",
    "WorldFrame": "scoup.base",
    "ScoupError": "scoup.base",
    "ScoupWarning": "scoup.base",
    "load_gaussians": "scoup.io",
    "save_gaussians": "scoup.io",
    "load_cameras": "scoup.io",
    "load_regions": "scoup.io",
    "load_image": "scoup.io",
    "Codebook": "scoup.coding",
    "fit_codes": "scoup.coding",
    "choose_cameras": "scoup.extract",
    "save_views": "scoup.extract",
    "project": "scoup.raster",
    "RegionSums": "scoup.uplift",
    "region_sums": "scoup.uplift",
    "find_things": "scoup.uplift",
    "vote": "scoup.uplift",
    "LanguageField": "scoup.query",
    "FieldInfo": "scoup.field",
    "build": "scoup.query",
    "RegionEmbeddings": "scoup.uplift",
    "code_regions": "scoup.uplift",
    "check_scene": "scoup.uplift",
    "pack": "scoup.uplift",
    "BuildSettings": "scoup.uplift",
    "FieldSources": "scoup.uplift",
    "transfer": "scoup.uplift",
    "TextEncoder": "scoup.models",
    "Answer": "scoup.query",
    "ExpressionAnswer": "scoup.query",
    "Question": "scoup.query",
    "ViewAnswer": "scoup.query",
    "Place": "scoup.query",
    "Reshaping": "scoup.query",
    "GaussianLabels": "scoup.query",
    "parse_expression": "scoup.query",
    "Archive": "scoup.archive",
    "refine": "scoup.query",
    "open_viewer": "scoup.view",
}

__all__ = ["__version__", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from scoup.archive import Archive as Archive
    from scoup.base import VERSION as __version__
    from scoup.base import ScoupError as ScoupError
    from scoup.base import ScoupWarning as ScoupWarning
    from scoup.base import WorldFrame as WorldFrame
    from scoup.coding import Codebook as Codebook
    from scoup.coding import fit_codes as fit_codes
    from scoup.extract import choose_cameras as choose_cameras
    from scoup.extract import save_views as save_views
    from scoup.field import FieldInfo as FieldInfo
    from scoup.io import load_cameras as load_cameras
    from scoup.io import load_gaussians as load_gaussians
    from scoup.io import load_image as load_image
    from scoup.io import load_regions as load_regions
    from scoup.io import save_gaussians as save_gaussians
    from scoup.models import TextEncoder as TextEncoder
    from scoup.query import Answer as Answer
    from scoup.query import ExpressionAnswer as ExpressionAnswer
    from scoup.query import GaussianLabels as GaussianLabels
    from scoup.query import LanguageField as LanguageField
    from scoup.query import Place as Place
    from scoup.query import Question as Question
    from scoup.query import Reshaping as Reshaping
    from scoup.query import ViewAnswer as ViewAnswer
    from scoup.query import build as build
    from scoup.query import parse_expression as parse_expression
    from scoup.query import refine as refine
    from scoup.raster import project as project
    from scoup.scene import Camera as Camera
    from scoup.scene import Cameras as Cameras
    from scoup.scene import Gaussians as Gaussians
    from scoup.scene import RegionMap as RegionMap
    from scoup.scene import Regions as Regions
    from scoup.scene import SparseCodes as SparseCodes
    from scoup.uplift import BuildSettings as BuildSettings
    from scoup.uplift import FieldSources as FieldSources
    from scoup.uplift import RegionEmbeddings as RegionEmbeddings
    from scoup.uplift import RegionSums as RegionSums
    from scoup.uplift import check_scene as check_scene
    from scoup.uplift import code_regions as code_regions
    from scoup.uplift import find_things as find_things
    from scoup.uplift import pack as pack
    from scoup.uplift import region_sums as region_sums
    from scoup.uplift import transfer as transfer
    from scoup.uplift import vote as vote
    from scoup.view import open_viewer as open_viewer


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f"module 'scoup' has no attribute {name!r}")
    import importlib

    module = importlib.import_module(_HOMES.get(name, "scoup.base"))
    value = getattr(module, "VERSION" if name == "__version__" else name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
