"""Well-known files of other programs whose endings say little: JSON and .npz, told by the names of their entries."""

from __future__ import annotations

from collections.abc import Iterable

_KINDS = {
    ("poses", "K"): ("is Record3D's metadata", "make transforms.json of it: ns-process-data record3d"),
    ("camera_path",): (
        "is a camera path of nerfstudio: views of a video, not of photographs", "use the scene's transforms.json",
    ),
    ("means3D", "log_scales"): (
        "is a map of SplaTAM or a relative", "export a PLY of it with its scripts/export_ply.py",
    ),
    ("version", "means", "sh0"): ("is the meta.json of a SOG without its images", "copy the whole folder"),
    ("means", "sh0"): (
        "is gsplat's compression of a splat, not a SOG", "export the splat as PLY or .sog with gsplat (export_splats)",
    ),
    ("transform", "scale"): (
        "is the dataparser_transforms.json of nerfstudio, without cameras", "use the folder of the training",
    ),
    ("sfm_data_version",): ("is a scene of OpenMVG", "export it to COLMAP: openMVG_main_openMVG2Colmap"),
    ("poses", "views"): ("is a scene of Meshroom", "export it to COLMAP, with its node ConvertSfMFormat"),
    ("reference_lla",): ("is a reconstruction of OpenSfM", "export it to COLMAP: opensfm export_colmap"),
    ("annotations", "categories"): ("contains annotations of COCO", "use cameras or a word table"),
    ("info", "objects"): ("contains labels of LERF-OVS", "pass their folder to scoup eval"),
}  # fmt: skip
"""What a file is, and the remedy, by entries that it has."""


def foreign_kind(entries: Iterable[str]) -> tuple[str, str] | None:
    """Return what a file with entries of these names is, and the remedy; None where it is of no known kind."""
    there = {str(entry).removesuffix(".npy") for entry in entries}
    return next((said for names, said in _KINDS.items() if there.issuperset(names)), None)
