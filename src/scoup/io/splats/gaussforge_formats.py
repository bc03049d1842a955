""".ksplat and .sog, read and written through the package gaussforge (extra ``scoup[splats]``).

Its compiled code ends the whole process on some damaged files, so it works in a process of its own, with limits of
memory and time. What it does to the values of Gaussians is said in docs/formats.md.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
import tempfile
import warnings
import zipfile
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from scoup.base import FileFormatError, ScoupError, ScoupWarning, atomic_file, existing_file
from scoup.io.reading import read_json
from scoup.io.splats.ply import PlyTable, write_ply
from scoup.io.splats.splat_format import SplatFormat
from scoup.scene import Gaussians

HOW_TO_GET_IT = "needs the package gaussforge: pip install 'scoup[splats]', and run again"
_KSPLAT, _META = ".ksplat", "meta.json"
_WHOLE = "copy the whole folder of the SOG"
_LEAST_SECONDS = 120
_SECONDS_A_MEGABYTE = 2.0
_LEAST_MEMORY, _MEMORY_A_BYTE = 4 << 30, 200
_WHAT_IT_IS = "it is damaged or not of this kind; copy it again, or convert it to PLY with splat-transform"
_PROGRAM = """
import sys
source, kind, target, wanted, memory = sys.argv[1:]
try:
    import resource
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
except ImportError:
    pass
import gaussforge
with open(source, "rb") as stream:
    content = stream.read()
converted = gaussforge.GaussForge().convert(content, kind, wanted)
if "error" in converted or not len(converted["data"]):
    sys.exit(3)
with open(target, "wb") as stream:
    stream.write(converted["data"])
"""


def read_through_gaussforge(path: str | Path) -> Gaussians:
    path = existing_file(path, "a splat")
    gaussians = _converted(path, path, path.suffix.lower()[1:])
    if path.suffix.lower() == _KSPLAT:
        return replace(gaussians, sh=_reordered_for_ksplat(gaussians.sh, inverse=True))
    return gaussians


def read_sog_folder(path: str | Path) -> Gaussians:
    """Read the meta.json of a SOG whose images lie beside it, which a .sog has in one archive."""
    content = read_json(path, "the meta.json of a SOG")
    entries = [entry for entry in content.object().values() if isinstance(entry, dict)]
    names = [name for entry in entries for name in entry.get("files", []) if isinstance(name, str)]
    if "means" not in content.object() or not names:
        raise FileFormatError(path, "is not the meta.json of a SOG", _WHAT_IT_IS)
    with tempfile.TemporaryDirectory(prefix="scoup-") as folder:
        made = Path(folder) / "splat.sog"
        with zipfile.ZipFile(made, "w") as archive:
            for name in [Path(path).name, *names]:
                if Path(name).name != name:
                    raise FileFormatError(path, f"names {name!r}, which is not beside it", _WHAT_IT_IS)
                archive.write(
                    existing_file(Path(path).parent / name, "a part of a SOG", _WHOLE), name.lower()
                )
        return _converted(Path(path), made, "sog")


def _converted(path: Path, source: Path, kind: str) -> Gaussians:
    """Return the Gaussians that gaussforge finds in a file ``source``; ``path`` is for messages."""
    with tempfile.TemporaryDirectory(prefix="scoup-") as folder:
        made = Path(folder) / "splat.ply"
        if not _convert(source, kind, made, "ply"):
            raise FileFormatError(path, "cannot be read by gaussforge", _WHAT_IT_IS)
        try:
            return PlyTable.read(made).gaussians()[0]
        except FileFormatError as error:
            raise FileFormatError(path, f"is damaged (converted, it {error.problem})", _WHAT_IT_IS) from error


def _is_sog(path: Path) -> bool:
    return path.name == _META and any(path.parent.glob("*.webp"))


def write_through_gaussforge(gaussians: Gaussians, path: str | Path, overwrite: bool = False) -> None:
    path = Path(path)
    if path.suffix.lower() == _KSPLAT:
        if gaussians.sh_degree > 2:
            warnings.warn(
                f"{path}: SH degree {gaussians.sh_degree} was cut to 2, for .ksplat",
                ScoupWarning,
                stacklevel=2,
            )
        gaussians = replace(gaussians, sh=_reordered_for_ksplat(gaussians.sh[:, :9]))
    with tempfile.TemporaryDirectory(prefix="scoup-") as folder:
        plain, made = Path(folder) / "splat.ply", Path(folder) / "converted"
        write_ply(gaussians, plain)
        if not _convert(plain, "ply", made, path.suffix.lower()[1:]):
            raise ScoupError(f"{path}: gaussforge cannot write these Gaussians; use another format")
        with atomic_file(path, overwrite) as stream:
            stream.write(made.read_bytes())


def _reordered_for_ksplat(sh: Tensor, inverse: bool = False) -> Tensor:
    """Return harmonics that gaussforge writes to a .ksplat in the order of the format; the ``inverse``, of what it has
    read, in our order.

    gaussforge takes a .ksplat's for all coefficients of red, then of green and blue. The format has those of degree 1
    first, channel by channel, then those of degree 2 (SplatBuffer.js of GaussianSplats3D).
    """
    above = sh.shape[1] - 1
    places = [
        channel * above + number - 1
        for degree in range(1, round(sh.shape[1] ** 0.5))
        for channel in range(3)
        for number in range(degree**2, (degree + 1) ** 2)
    ]
    order = torch.tensor(places, dtype=torch.int64)
    flat = sh[:, 1:].transpose(1, 2).flatten(1)[:, order.argsort() if inverse else order]
    higher = flat.reshape(len(sh), 3, above).transpose(1, 2)
    return torch.cat([sh[:, :1], higher], dim=1).contiguous()


def _convert(source: Path, kind: str, target: Path, wanted: str) -> bool:
    """Return whether gaussforge has converted a file, in a process of its own."""
    if importlib.util.find_spec("gaussforge") is None:
        raise ScoupError(f".{wanted if kind == 'ply' else kind} {HOW_TO_GET_IT}")
    size = source.stat().st_size
    memory = _LEAST_MEMORY + _MEMORY_A_BYTE * size
    seconds = _LEAST_SECONDS + _SECONDS_A_MEGABYTE * size / 1e6
    command = [sys.executable, "-I", "-c", _PROGRAM, str(source), kind, str(target), wanted, str(memory)]
    try:
        done = subprocess.run(command, capture_output=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        raise FileFormatError(
            source, f"takes gaussforge more than {seconds:.0f} seconds", _WHAT_IT_IS
        ) from None
    return done.returncode == 0 and target.is_file()


KSPLAT = SplatFormat(_KSPLAT, (_KSPLAT,), read_through_gaussforge, write_through_gaussforge, extra="splats")
SOG = SplatFormat(".sog", (".sog",), read_through_gaussforge, write_through_gaussforge, extra="splats")
SOG_FOLDER = SplatFormat("unbundled SOG", (_META,), read_sog_folder, has_name=_is_sog, extra="splats")
