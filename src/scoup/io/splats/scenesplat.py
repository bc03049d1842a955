"""Gaussians as SceneSplat's preprocessing leaves them: a folder with one .npy file a property (docs/formats.md).

Read from zenghjian/SceneSplat, ``pointcept/datasets/preprocessing/scannet/preprocess_scannet_gs.py``: values are
activated, colours are those of SH degree 0 in bytes.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from scoup.base.errors import FileFormatError
from scoup.base.staging import staged
from scoup.io.npy import open_npy
from scoup.io.splats.activation import keep_finite, unit_quats
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene.gaussians import SH_C0, Gaussians

SHAPES: dict[str, tuple[int, ...]] = {
    "coord": (3,),
    "color": (3,),
    "opacity": (),
    "scale": (3,),
    "quat": (4,),
}
"""Property -> shape of one row."""


def is_scenesplat(folder: Path) -> bool:
    """Return whether a folder holds Gaussians of this kind (points alone have no opacity)."""
    return (folder / "coord.npy").is_file() and (folder / "opacity.npy").is_file()


def read_scenesplat(folder: str | Path) -> Gaussians:
    """Read Gaussians of SH degree 0 from coord.npy, color.npy, opacity.npy, scale.npy and quat.npy."""
    folder = Path(folder)
    values = {name: _column(folder / f"{name}.npy", shape) for name, shape in SHAPES.items()}
    for name, column in values.items():
        if len(column) != len(values["coord"]):
            raise FileFormatError(
                folder / f"{name}.npy",
                f"has {len(column)} rows, coord.npy has {len(values['coord'])}",
                "all are of one preprocessing",
            )
    for name in ("scale", "opacity"):
        if (values[name] < 0).any():
            raise FileFormatError(
                folder / f"{name}.npy", "has negative values", "expected activated values, not logarithms"
            )
    sh = (values["color"] / np.float32(255) - np.float32(0.5)) / np.float32(SH_C0)
    return keep_finite(
        means=values["coord"],
        quats=unit_quats(values["quat"]),
        scales=values["scale"],
        opacities=values["opacity"],
        sh=sh[:, None],
        source=str(folder),
    )[0]


def write_scenesplat(gaussians: Gaussians, folder: str | Path, overwrite: bool = False) -> None:
    """Write Gaussians; of their colours only SH degree 0, in bytes."""
    rgb = (gaussians.sh[:, 0].cpu().numpy() * SH_C0 + 0.5).clip(0, 1)
    values = {
        "coord": gaussians.means.cpu().numpy(),
        "color": (rgb * 255).astype(np.uint8),
        "opacity": gaussians.opacities.cpu().numpy(),
        "scale": gaussians.scales.cpu().numpy(),
        "quat": gaussians.quats.cpu().numpy(),
    }
    with staged(Path(folder), [f"{name}.npy" for name in values], overwrite) as hidden:
        hidden.mkdir(parents=True, exist_ok=True)
        for name, column in values.items():
            np.save(hidden / f"{name}.npy", column)


def _column(path: Path, shape: tuple[int, ...]) -> np.ndarray:
    """Return [N, *shape] float32; a column of its own ([N, 1]) is taken for one number per row."""
    column = open_npy(path, f"{path.stem} of Gaussians", "use a folder of SceneSplat's preprocessing")
    if not shape and column.ndim == 2 and column.shape[1] == 1:
        column = column[:, 0]
    if column.shape[1:] != shape or not column.ndim:
        expected = ["Gaussians", *map(str, shape)]
        raise FileFormatError(
            path, f"is {list(column.shape)}, expected [{', '.join(expected)}]", "preprocess it again"
        )
    with np.errstate(all="ignore"):
        return np.array(column, dtype=np.float32)


FORMAT = SplatFormat(
    "SceneSplat's arrays",
    read=read_scenesplat,
    preset="gsplat",
    find=lambda folder: folder if is_scenesplat(folder) else None,
)
