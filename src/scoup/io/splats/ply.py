"""PLY files: any table of scalars losslessly, and the Inria layout of 3D Gaussian Splatting."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.lib.recfunctions import structured_to_unstructured

from scoup.base import MOST_ROWS_IN_MEMORY, FileFormatError, ScoupWarning, atomic_file, listed
from scoup.io.cameras.inria import latest_point_cloud
from scoup.io.splats.activation import (
    SH_BASES,
    keep_finite,
    logits_from_opacities,
    logs_and_logits,
    logs_from_scales,
    opacities_from_logits,
    scales_from_logs,
    three_logs,
    unit_quats,
)
from scoup.io.splats.ply_compressed import is_compressed, read_compressed, write_compressed_ply
from scoup.io.splats.ply_header import MIP, PlyHeader, format_header, ply_type, read_header, rest_names
from scoup.io.splats.ply_rows import read_large, read_rows
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene import SH_C0, Gaussians

_CENTER = ("x", "y", "z")
_BASE_COLOR = ("f_dc_0", "f_dc_1", "f_dc_2")
_RGB = ("red", "green", "blue")  # in place of the base colour
_SCALE = ("scale_0", "scale_1", "scale_2")
_ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
_FILTER = "filter_3D"
_OTHERWISE = re.compile(
    r"(trbf|motion|omega|delta|velocity|time|scal(e|ing)_t|rot_r)(_.*)?|t|scale_[3-9]|rot_[4-9]|"  # in time
    r"(shape|wave|beta|nu|nu_degree|sb_params)(_\d+)?"  # of kernels
)
_SAYS_MIP = re.compile(
    r"SplatRenderMode:? *mip|antialiased[:=]? *(1|true)|rasterize_mode[:=]? *antialiased", re.I
)
_REQUIRED = (*_CENTER, *_BASE_COLOR, "opacity", *_SCALE, *_ROTATION)
_CHUNK = 1 << 16


@dataclass(frozen=True, eq=False)
class PlyTable:
    """The vertices of a PLY file, untouched."""

    path: Path
    """Where it was read from."""
    rows: np.ndarray
    """[N] structured array, little endian, one field per property, in the file's order and types."""
    comments: tuple[str, ...] = ()
    """Comment lines of the header, without the keyword."""

    @classmethod
    def read(cls, path: str | Path) -> PlyTable:
        """Read the vertices of a PLY file (binary of either byte order, or ASCII) without interpreting them; what is
        behind those of its header is not read, with a warning."""
        header = read_header(path)
        return cls(header.path, read_rows(header), header.comments)

    @classmethod
    def of(cls, gaussians: Gaussians) -> PlyTable:
        """Return the Gaussians as rows of the Inria layout: centre, zero normals, colour, opacity, scale, rotation."""
        values = {name: tensor.detach().cpu().numpy() for name, tensor in gaussians.tensors().items()}
        rest = 3 * (values["sh"].shape[1] - 1)
        higher = (f"f_rest_{number}" for number in range(rest))
        names = (*_CENTER, "nx", "ny", "nz", *_BASE_COLOR, *higher, "opacity", *_SCALE, *_ROTATION)
        rows = np.zeros(len(gaussians), dtype=[(name, "<f4") for name in names])
        every = rows.view("<f4").reshape(len(gaussians), len(names))
        every[:, 0:3] = values["means"]
        every[:, 6:9] = values["sh"][:, 0]
        every[:, 9 : 9 + rest] = values["sh"][:, 1:].transpose(0, 2, 1).reshape(len(gaussians), rest)
        every[:, -8] = logits_from_opacities(values["opacities"])
        every[:, -7:-4] = logs_from_scales(values["scales"])
        every[:, -4:] = values["quats"]
        return cls(Path("<memory>"), rows, (MIP,) if gaussians.antialiased else ())

    def __len__(self) -> int:
        return len(self.rows)

    @property
    def names(self) -> tuple[str, ...]:
        return self.rows.dtype.names or ()

    def select(self, chosen: np.ndarray) -> PlyTable:
        """Return the chosen rows, unchanged. ``chosen`` is a boolean mask [N] or row numbers [M]."""
        return replace(self, rows=self.rows[chosen])

    def with_column(self, name: str, values: np.ndarray) -> PlyTable:
        """Return the table with one more property at the end (or another one in its place), for example an id."""
        columns = [(item, self.rows.dtype[item]) for item in self.names if item != name]
        rows = np.empty(len(self.rows), dtype=[*columns, (name, ply_type(values.dtype).newbyteorder("<"))])
        for item, _ in columns:
            rows[item] = self.rows[item]
        rows[name] = values
        return replace(self, rows=rows)

    def columns(self, names: tuple[str, ...], dtype: type = np.float32) -> np.ndarray:
        """Return [N, len(names)] of ``dtype``, the named properties side by side."""
        with np.errstate(all="ignore"):  # a file may contain any values
            return structured_to_unstructured(self.rows[list(names)], copy=False).astype(dtype)

    def gaussians(self, activated: bool | None = None) -> tuple[Gaussians, np.ndarray]:
        """Return activated Gaussians of the table, and a boolean [N] saying which rows they are.

        Scales are exponentials, opacities logistic (+inf gives 1), quaternions normalised. Rows with values that
        are not finite (a zero quaternion is one) are dropped, with a warning.

        Args:
            activated: scales and opacities are stored as they are, where their values allow it. A FileFormatError if
                false and they seem to be; None: not looked at.
        """
        return keep_finite(**_activated(self, activated), source=str(self.path))

    def write(self, path: str | Path, overwrite: bool = False) -> None:
        """Write the table as binary PLY, its rows byte for byte."""
        with atomic_file(path, overwrite) as stream:
            stream.write(format_header(self.rows.dtype, len(self), self.comments))
            for start in range(0, len(self), _CHUNK):
                stream.write(self.rows[start : start + _CHUNK].tobytes())


def _activated(table: PlyTable, activated: bool | None = None) -> dict[str, np.ndarray]:
    """Return values of all rows by the names of ``Gaussians``, finite or not."""
    rest = _check_properties(table)
    bases = 1 + len(rest) // 3
    sh = np.empty((len(table), bases, 3), dtype=np.float32)
    sh[:, 0] = _base_colors(table)
    if rest:
        # The file is channel-major: all of red, then green, then blue.
        sh[:, 1:] = table.columns(rest).reshape(len(table), 3, bases - 1).transpose(0, 2, 1)
    means, opacities = table.columns(_CENTER), table.columns(("opacity",))[:, 0]
    scales = table.columns(tuple(name for name in _SCALE if name in table.names))
    logs, logits = logs_and_logits(table.path, means, scales, opacities, activated)
    scales, opacities = scales_from_logs(three_logs(logs)), opacities_from_logits(logits)
    if _FILTER in table.names:
        # Of Mip-Splatting: the least size that the photographs resolve, which widens a Gaussian and makes it fainter.
        with np.errstate(all="ignore"):
            before = scales.astype(np.float64) ** 2
            after = before + table.columns((_FILTER,), np.float64) ** 2
            scales = np.sqrt(after).astype(np.float32)
            opacities = (opacities * np.sqrt((before / after).prod(1))).astype(np.float32)
    return {
        "means": means,
        "quats": unit_quats(table.columns(_ROTATION)),
        "scales": scales,
        "opacities": opacities,
        "sh": sh,
    }


def _base_colors(table: PlyTable) -> np.ndarray:
    """Return [N, 3] coefficients of degree 0; colours are 0 to 1, or 0 to the most of whole numbers."""
    if _BASE_COLOR[0] in table.names:
        return table.columns(_BASE_COLOR)
    kind = table.rows.dtype[_RGB[0]]
    most = 1.0 if kind.kind == "f" else float(np.iinfo(kind).max)
    return ((table.columns(_RGB, np.float64) / most - 0.5) / SH_C0).astype(np.float32)


def read_ply(path: str | Path, activated: bool = False) -> Gaussians:
    """Read a 3D Gaussian Splatting PLY; properties are found by name, in any order, SH degree 0 to 4.

    Two scales (2DGS) or one, red, green, blue in place of f_dc, and compressed files as PlayCanvas and SuperSplat write
    them are read, too. Of more than ``MOST_ROWS_IN_MEMORY`` rows in a binary file, the values are in temporary files
    (TMPDIR). ``activated`` is as of ``PlyTable.gaussians``.
    """
    header = read_header(path)
    if is_compressed(header.dtype.names or ()):
        gaussians = read_compressed(header.path, read_rows(header))
    elif header.count > MOST_ROWS_IN_MEMORY and header.encoding != "ascii":
        gaussians = read_large(header, lambda rows: _activated(PlyTable(header.path, rows), activated))
    else:
        gaussians = PlyTable(header.path, read_rows(header)).gaussians(activated)[0]
    _warn_of_other_gaussians(header)
    said = any(_SAYS_MIP.search(comment) for comment in header.comments)
    return replace(gaussians, antialiased=said or _FILTER in (header.dtype.names or ()))


def _warn_of_other_gaussians(header: PlyHeader) -> None:
    """Warn of Gaussians that change with time, or have another kernel."""
    more = [name for name in header.dtype.names or () if _OTHERWISE.fullmatch(name)]
    more += [name for name in ("deformation.pth",) if (header.path.parent / name).is_file()]
    if more:
        warnings.warn(
            f"{header.path}: its Gaussians change with time or have another kernel ({listed(more)}), which is ignored: "
            "renders may be wrong; use a splat of 3DGS, gsplat or splatfacto",
            ScoupWarning,
            stacklevel=4,
        )


def write_ply(gaussians: Gaussians, path: str | Path, overwrite: bool = False) -> None:
    """Write the Inria layout.

    Gaussians that were read from a PLY file or a checkpoint read back bit by bit. Others are rounded to the
    float32 logarithm and logit the layout holds.
    """
    PlyTable.of(gaussians).write(path, overwrite)


def _check_properties(table: PlyTable) -> tuple[str, ...]:
    if is_compressed(table.names):
        raise FileFormatError(
            table.path,
            "is a compressed PLY (PlayCanvas), whose rows do not stand alone",
            "convert it to a plain one: scoup convert in.compressed.ply out.ply",
        )
    names = {*table.names}
    if {*_RGB} <= names:
        names |= {*_BASE_COLOR}
    if [name in names for name in _SCALE] in ([True, False, False], [True, True, False]):
        names |= {*_SCALE}
    missing = [name for name in _REQUIRED if name not in names]
    if missing:
        remedy = "use the PLY of the trained splat, not a point cloud or mesh"
        if any(name.startswith("f_anchor_feat") for name in table.names):
            remedy = (
                "it has anchors of Scaffold-GS, from which networks make Gaussians; train with 3DGS or gsplat"
            )
        elif len(missing) <= len(_REQUIRED) // 2:
            remedy = "export the trained splat again, with these properties"
        problem = f"is not a 3D Gaussian Splatting PLY: it lacks {', '.join(missing)}"
        raise FileFormatError(table.path, problem, remedy)
    rest = rest_names(table.names)
    if rest is None:
        count = sum(name.startswith("f_rest_") for name in table.names)
        raise FileFormatError(
            table.path,
            f"has {count} f_rest properties, expected f_rest_0 onwards, {[3 * (bases - 1) for bases in SH_BASES]} "
            "of them",
            "export the splat again",
        )
    return rest


def _in_output(folder: Path) -> Path | None:
    is_output = folder.name == "point_cloud" or (folder / "point_cloud").is_dir()
    return latest_point_cloud(folder) if is_output else None


FORMAT = SplatFormat(
    "Inria PLY", (".ply",), read_ply, write_ply, find=_in_output, keeps_antialiased=True, keeps_logs=True
)
COMPRESSED = SplatFormat(
    "compressed PLY", (".compressed.ply",), read_ply, write_compressed_ply, keeps_antialiased=True
)
