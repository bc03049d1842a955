"""Readers and writers: one module per format; all give and take the dataclasses of ``scene/``."""

from scoup.base import atomic_file, atomic_path, check_output, write_text
from scoup.io.cameras.colmap import read_points, read_tracks, write_colmap
from scoup.io.cameras.inria import read_cfg_args
from scoup.io.cameras.nerfstudio import write_transforms
from scoup.io.images import load_image, save_label_png, save_png
from scoup.io.regions.convert import convert_regions
from scoup.io.regions.load import load_regions, save_regions
from scoup.io.scenes import (
    camera_photographs,
    load_cameras,
    load_gaussians,
    save_gaussians,
)
from scoup.io.splats.formats import splat_source, written_format
from scoup.io.splats.ply import (
    PlyTable,
    as_stored,
    gaussians_from_table,
    read_ply_table,
    write_ply,
    write_ply_table,
)

__all__ = [
    "PlyTable",
    "as_stored",
    "atomic_file",
    "atomic_path",
    "camera_photographs",
    "check_output",
    "convert_regions",
    "gaussians_from_table",
    "load_cameras",
    "load_gaussians",
    "load_image",
    "load_regions",
    "read_cfg_args",
    "read_ply_table",
    "read_points",
    "read_tracks",
    "save_gaussians",
    "save_label_png",
    "save_png",
    "save_regions",
    "splat_source",
    "write_colmap",
    "write_ply",
    "write_ply_table",
    "write_text",
    "write_transforms",
    "written_format",
]
