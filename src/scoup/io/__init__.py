"""Readers and writers of files of others: splats, cameras, photographs, regions; one module per format.

All take and return the dataclasses of ``scene``. Readers check what a header claims; writers write whole files or
nothing. ``load_...`` finds the format by the contents, ``write_...`` writes one.
"""

from scoup.io.camera_images import attach_images
from scoup.io.cameras.colmap import read_points, read_tracks
from scoup.io.cameras.nerfstudio import write_transforms
from scoup.io.descriptions import describe
from scoup.io.detections import DetectionStore
from scoup.io.gaussian_features import read_features
from scoup.io.image_folder import DYNAMIC_MASK
from scoup.io.images import ANY_PIXELS, load_image, open_image, rgb_image, save_png
from scoup.io.langsplat_checkpoint import read_langsplat
from scoup.io.reading import MAX_IMAGE_SIDE, read_json
from scoup.io.regions.convert import convert_regions
from scoup.io.regions.langsplat_autoencoder import Decoder, read_autoencoder
from scoup.io.regions.load import load_regions, save_regions
from scoup.io.regions.manifest import RegionManifest
from scoup.io.regions.store import RegionStore
from scoup.io.regions.views import ViewRegions
from scoup.io.scene_parts import ScenePaths
from scoup.io.scenes import load_cameras, load_gaussians, save_gaussians
from scoup.io.similarity import read_similarity
from scoup.io.splats.formats import is_splat_name, splat_source, written_format
from scoup.io.splats.gltf_write import write_gltf
from scoup.io.splats.ply import PlyTable
from scoup.io.splats.rotation import spread_directions
from scoup.io.splats.splat_format import SplatFormat
from scoup.io.splats.usd import UsdThing, write_usd
from scoup.io.word_list import read_words

__all__ = [
    "ANY_PIXELS",
    "DYNAMIC_MASK",
    "MAX_IMAGE_SIDE",
    "Decoder",
    "DetectionStore",
    "PlyTable",
    "RegionManifest",
    "RegionStore",
    "ScenePaths",
    "SplatFormat",
    "UsdThing",
    "ViewRegions",
    "attach_images",
    "convert_regions",
    "describe",
    "is_splat_name",
    "load_cameras",
    "load_gaussians",
    "load_image",
    "load_regions",
    "open_image",
    "read_autoencoder",
    "read_features",
    "read_json",
    "read_langsplat",
    "read_points",
    "read_similarity",
    "read_tracks",
    "read_words",
    "rgb_image",
    "save_gaussians",
    "save_png",
    "save_regions",
    "splat_source",
    "spread_directions",
    "write_gltf",
    "write_transforms",
    "write_usd",
    "written_format",
]
