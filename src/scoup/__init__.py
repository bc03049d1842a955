"""SCOUP: language fields for trained 3D Gaussian Splatting scenes by sparse code uplifting.

Names are loaded when first used, so that ``import scoup`` stays fast and needs neither torch nor a GPU.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from scoup.base import VERSION as __version__

_HOMES = {
    "Gaussians": "scoup.scene.gaussians",
    "Camera": "scoup.scene.cameras",
    "Cameras": "scoup.scene.cameras",
    "RegionMap": "scoup.scene.regions",
    "Regions": "scoup.scene.regions",
    "SparseCodes": "scoup.scene.codes",
    "ScoupError": "scoup.base.errors",
    "ScoupWarning": "scoup.base.errors",
    "load_gaussians": "scoup.io",
    "save_gaussians": "scoup.io",
    "load_cameras": "scoup.io",
    "load_regions": "scoup.io",
    "load_image": "scoup.io",
    "Codebook": "scoup.coding",
    "fit_codes": "scoup.coding",
    "choose_cameras": "scoup.extract.own_views",
    "save_views": "scoup.extract.own_views",
    "project": "scoup.raster",
    "RegionSums": "scoup.uplift.region_sums",
    "region_sums": "scoup.uplift.rasterise",
    "find_things": "scoup.uplift.things",
    "vote": "scoup.uplift.vote",
    "LanguageField": "scoup.query.language_field",
    "FieldInfo": "scoup.field.field_info",
    "build": "scoup.query.language_field",
    "RegionEmbeddings": "scoup.uplift.region_codes",
    "code_regions": "scoup.uplift.region_codes",
    "check_scene": "scoup.uplift.build",
    "pack": "scoup.uplift.build",
    "BuildSettings": "scoup.uplift.build_settings",
    "FieldSources": "scoup.uplift.provenance",
    "transfer": "scoup.uplift.transfer",
    "TextEncoder": "scoup.models.text",
    "Answer": "scoup.query.answer",
    "ExpressionAnswer": "scoup.query.answer",
    "Question": "scoup.query.question",
    "ViewAnswer": "scoup.query.view_answer",
    "Place": "scoup.query.place",
    "Reshaping": "scoup.query.select",
    "GaussianLabels": "scoup.query.labels",
    "parse_expression": "scoup.query.expression",
    "Archive": "scoup.archive.archive",
    "refine": "scoup.query.refine",
    "open_viewer": "scoup.view.viewer",
}

__all__ = ["__version__", *_HOMES]  # pyright: ignore[reportUnsupportedDunderAll]

if TYPE_CHECKING:
    from scoup.archive.archive import Archive as Archive
    from scoup.base import ScoupError as ScoupError
    from scoup.base import ScoupWarning as ScoupWarning
    from scoup.coding import Codebook as Codebook
    from scoup.coding import fit_codes as fit_codes
    from scoup.extract.own_views import choose_cameras as choose_cameras
    from scoup.extract.own_views import save_views as save_views
    from scoup.field.field_info import FieldInfo as FieldInfo
    from scoup.io import load_cameras as load_cameras
    from scoup.io import load_gaussians as load_gaussians
    from scoup.io import load_image as load_image
    from scoup.io import load_regions as load_regions
    from scoup.io import save_gaussians as save_gaussians
    from scoup.models.text import TextEncoder as TextEncoder
    from scoup.query.answer import Answer as Answer
    from scoup.query.answer import ExpressionAnswer as ExpressionAnswer
    from scoup.query.expression import parse_expression as parse_expression
    from scoup.query.labels import GaussianLabels as GaussianLabels
    from scoup.query.language_field import LanguageField as LanguageField
    from scoup.query.language_field import build as build
    from scoup.query.place import Place as Place
    from scoup.query.question import Question as Question
    from scoup.query.refine import refine as refine
    from scoup.query.select import Reshaping as Reshaping
    from scoup.query.view_answer import ViewAnswer as ViewAnswer
    from scoup.raster import project as project
    from scoup.scene.cameras import Camera as Camera
    from scoup.scene.cameras import Cameras as Cameras
    from scoup.scene.codes import SparseCodes as SparseCodes
    from scoup.scene.gaussians import Gaussians as Gaussians
    from scoup.scene.regions import RegionMap as RegionMap
    from scoup.scene.regions import Regions as Regions
    from scoup.uplift.build import check_scene as check_scene
    from scoup.uplift.build import pack as pack
    from scoup.uplift.build_settings import BuildSettings as BuildSettings
    from scoup.uplift.provenance import FieldSources as FieldSources
    from scoup.uplift.rasterise import region_sums as region_sums
    from scoup.uplift.region_codes import RegionEmbeddings as RegionEmbeddings
    from scoup.uplift.region_codes import code_regions as code_regions
    from scoup.uplift.region_sums import RegionSums as RegionSums
    from scoup.uplift.things import find_things as find_things
    from scoup.uplift.transfer import transfer as transfer
    from scoup.uplift.vote import vote as vote
    from scoup.view.viewer import open_viewer as open_viewer


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'scoup' has no attribute {name!r}")
    import importlib

    value = getattr(importlib.import_module(_HOMES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted(__all__)
