"""The method: from region embeddings and a splat to codes, things and a field.

Each stage is a function: ``code_regions``, ``region_sums``, ``find_things``, ``vote``, ``pack``; ``build`` calls them
in this order. Region sums are files in one folder, so that views can be shared out and added.
"""

from scoup.uplift.field_build import build, check_scene, pack
from scoup.uplift.field_transfer import transfer
from scoup.uplift.fit import measure_fit
from scoup.uplift.foreign import foreign_field
from scoup.uplift.model_choice import fitting_scene
from scoup.uplift.naming import name_field
from scoup.uplift.near_plane import scene_preset
from scoup.uplift.provenance import FieldSources, embedding_source
from scoup.uplift.rasterise import cameras_with_regions, open_sums, region_sums
from scoup.uplift.region_codes import RegionEmbeddings, code_regions
from scoup.uplift.settings import BuildSettings, build_settings
from scoup.uplift.stored_sums import RegionSums
from scoup.uplift.things import find_things
from scoup.uplift.voting import GaussianCodes, vote

__all__ = [
    "BuildSettings",
    "FieldSources",
    "GaussianCodes",
    "RegionEmbeddings",
    "RegionSums",
    "build",
    "build_settings",
    "cameras_with_regions",
    "check_scene",
    "code_regions",
    "embedding_source",
    "find_things",
    "fitting_scene",
    "foreign_field",
    "measure_fit",
    "name_field",
    "open_sums",
    "pack",
    "region_sums",
    "scene_preset",
    "transfer",
    "vote",
]
