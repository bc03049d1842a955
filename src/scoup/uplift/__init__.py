"""The method: from region embeddings and a splat to codes, things and a field.

Each stage is a function: ``code_regions``, ``region_sums``, ``find_things``, ``vote``, ``pack``; ``build`` calls them
in this order. Region sums are files in one folder, so that views can be shared out and added.
"""

from scoup.uplift.field_build import build, check_scene, pack
from scoup.uplift.field_transfer import transfer
from scoup.uplift.fit import Verdict, fit_problem, measure_fit
from scoup.uplift.foreign import field_from_features, field_from_langsplat, langsplat_levels
from scoup.uplift.naming import name_field, name_things
from scoup.uplift.near_plane import near_plane_note, scene_preset
from scoup.uplift.provenance import FieldSources, embedding_source
from scoup.uplift.rasterise import add_views, cameras_with_regions, open_sums, region_sums
from scoup.uplift.region_codes import RegionEmbeddings, code_regions
from scoup.uplift.settings import BUILD_PRESETS, BuildSettings, build_settings
from scoup.uplift.storage.array_file import has_region_sums, stored_size
from scoup.uplift.stored_sums import RegionSums, Rows
from scoup.uplift.things import find_things
from scoup.uplift.voting import GaussianCodes, vote

__all__ = [
    "BUILD_PRESETS",
    "BuildSettings",
    "FieldSources",
    "GaussianCodes",
    "RegionEmbeddings",
    "RegionSums",
    "Rows",
    "Verdict",
    "add_views",
    "build",
    "build_settings",
    "cameras_with_regions",
    "check_scene",
    "code_regions",
    "embedding_source",
    "field_from_features",
    "field_from_langsplat",
    "find_things",
    "fit_problem",
    "has_region_sums",
    "langsplat_levels",
    "measure_fit",
    "name_field",
    "name_things",
    "near_plane_note",
    "open_sums",
    "pack",
    "region_sums",
    "scene_preset",
    "stored_size",
    "transfer",
    "vote",
]
