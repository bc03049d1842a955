"""The region sums of all views: how much each Gaussian paints of each region, made once (method.md, stage 2).

Everything after rasterising reads only these: codes, rounds of the vote, other embeddings, more or fewer views. They
grow view by view, in memory or in a folder with one file per view: a checkpoint of a build, kept sums, a shard.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.atomic import remove
from scoup.base.errors import FileFormatError, InputError, MissingFileError, WriteError, check_format_version
from scoup.base.file_names import slug
from scoup.base.shares import Share
from scoup.raster import ViewSums, morton_order
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.uplift.storage.array_file import StoredArrays, read_arrays, write_arrays
from scoup.uplift.storage.entries import BUCKET, ViewRecord
from scoup.uplift.storage.matrices import csr_matrix, triplets_of
from scoup.uplift.storage.packing import Packer

if TYPE_CHECKING:
    from scipy.sparse import csr_array

VERSION = 1
ENDING = ".safetensors"
SCENE, CODES, INPUTS = "scene", "codes", "inputs"  # files that are no views
_VIEW = "view."  # the names of the others begin with it

Rows = Sequence[Mapping[str, slice]]
"""Per level, the rows of each view in the stacked embeddings (``Regions.embeddings``)."""


class RegionSums:
    """The region sums of views of one scene, added one by one.

    Gaussians are kept in Morton order, whatever backend made the sums.

    Args:
        fingerprint: of the Gaussians.
        order: [N] int64, the row of the scene that each Gaussian here is.
        levels: level names.
        raster_preset: rasteriser constants.
        path: keep them in this new folder, which must not exist and is made with the first view; None keeps them in
            memory.
        weights: "float32", or "float16" for less space.
        least_weight: entries below are left out; 0 keeps all.

    Attributes:
        path: the folder they are, or will be, kept in; None in memory.
        writable: whether views can be added.
        views: by name.
        rows: see ``Rows``; known where ``region_sums`` made them. ``matrix`` needs them.
        codes: what ``keep_codes`` was given last, None before.
        inputs: the same of ``keep_inputs``.

    Example:
        >>> gaussians, cameras = scoup.load_gaussians("scene/point_cloud.ply"), scoup.load_cameras("scene")
        >>> sums = scoup.region_sums(gaussians, cameras, scoup.load_regions("scene", cameras))
        >>> len(sums) == len(cameras)
        True
    """

    def __init__(
        self,
        fingerprint: str,
        order: Tensor,
        levels: Sequence[str],
        raster_preset: str = "inria",
        path: Path | None = None,
        weights: str = "float32",
        least_weight: float = 0.0,
    ) -> None:
        if weights not in ("float32", "float16"):
            raise InputError(f"weights of region sums are float32 or float16, not {weights!r}")
        if not 0 <= least_weight < 1:
            raise InputError(f"the least weight of an entry must be 0 to 1, got {least_weight}")
        if path is not None and path.exists():
            raise InputError(f"{path}: is there already; open it, or name another folder")
        self.fingerprint = fingerprint
        self.order = order.cpu()
        self.levels = tuple(levels)
        self.raster_preset = raster_preset
        self.path = path
        self.writable = True
        self.weights = weights
        self.least_weight = least_weight
        self.views: dict[str, ViewRecord] = {}
        self.rows: Rows | None = None
        self.codes: dict[str, Any] | None = None
        self.inputs: dict[str, Any] | None = None
        self._packer = Packer(self.order, weights, least_weight)
        self._bytes: dict[str, int] = {}  # of each file

    @classmethod
    def of(
        cls, gaussians: Gaussians, levels: Sequence[str], raster_preset: str = "inria", **more: Any
    ) -> RegionSums:
        """Empty sums of a scene; further arguments as above."""
        return cls(gaussians.fingerprint(), morton_order(gaussians.means), levels, raster_preset, **more)

    @classmethod
    def like(cls, other: RegionSums, path: Path | None = None) -> RegionSums:
        """Empty sums of the same Gaussians and levels, kept in the same way (``is_like``)."""
        kept_as = {"weights": other.weights, "least_weight": other.least_weight}
        return cls(other.fingerprint, other.order, other.levels, other.raster_preset, path, **kept_as)

    @classmethod
    def open(cls, path: str | Path, writable: bool = False) -> RegionSums:
        """Open kept sums, with their views in the order of their names. All is read once, to compare checksums.

        Args:
            path: the folder.
            writable: views can be added, by one process at a time: what a killed one was writing is removed.

        Raises:
            MissingFileError, FileFormatError: it is not there, is something else, damaged, or of a newer version.
        """
        path = Path(path)
        if not (path / _file(SCENE)).is_file():
            problem = "is not a folder of region sums" if path.exists() else "there is no such folder"
            raise MissingFileError(path, problem, "check the path")
        scene = path / _file(SCENE)
        head = read_arrays(scene)
        with _nonsense_named(scene):
            check_format_version(scene, head.header["version"], VERSION)
            order = torch.from_numpy(head.arrays["order"].astype(np.int64))
            if order.dim() != 1 or not torch.equal(order.sort().values, torch.arange(len(order))):
                raise ValueError("an order that lacks Gaussians")
            sums = cls(
                str(head.header["fingerprint"]),
                order,
                [str(level) for level in head.header["levels"]],
                str(head.header["raster_preset"]),
                weights=str(head.header["weights"]),
                least_weight=float(head.header["least_weight"]),
            )
        sums.path, sums.writable, sums._bytes[SCENE] = path, writable, head.bytes
        for file in sorted(path.glob(f"*{ENDING}")):
            if file.name.startswith("."):
                if writable:
                    remove(file)
            elif file != scene:
                sums._take(file.name.removesuffix(ENDING), file)
        sums.views = dict(sorted(sums.views.items()))
        return sums

    # ---- what they are

    @property
    def n_gaussians(self) -> int:
        return len(self.order)

    @property
    def n_buckets(self) -> int:
        return -(-self.n_gaussians // BUCKET)

    @property
    def bytes(self) -> int:
        """What they take, in memory or on disk."""
        return sum(self._bytes.values())

    @property
    def is_empty(self) -> bool:
        """Whether no Gaussian paints a region in any view."""
        return not any(len(part.places) for view in self.views.values() for part in view.parts)

    def __contains__(self, view_name: str) -> bool:
        return view_name in self.views

    def __len__(self) -> int:
        return len(self.views)

    def n_regions(self, view_name: str) -> list[int]:
        """[S]: one more than the highest region that an entry of a view can have at each level."""
        tables = [part.table for part in self._require(view_name).parts]
        highest = np.max([table.max(0, initial=-1) for table in tables], axis=0)
        return (highest + 1).tolist()

    # ---- how they grow

    def append(
        self, view_name: str, sums: ViewSums, camera: Camera | None = None, order: Tensor | None = None
    ) -> None:
        """Add a view, or replace the one of this name.

        Args:
            view_name: its name.
            sums: from ``raster.region_sums``.
            camera: its camera, by which a later one is compared.
            order: the row of the scene that each of the Gaussians rasterised is; None where none was moved.

        Raises:
            InputError: the sums are of another scene, or the file cannot be written.
        """
        if sums.table.shape[1] != len(self.levels):
            raise InputError(
                f"{view_name!r}: sums of {sums.table.shape[1]} levels, not of {list(self.levels)}"
            )
        digest = "" if camera is None else camera.fingerprint()
        view = ViewRecord(digest, sums.labels_digest, tuple(self._packer.entries(sums, order)))
        self.append_record(view_name, view)

    def append_record(self, view_name: str, view: ViewRecord) -> None:
        """Add or replace a view by entries of these Gaussians that are known, in the order of these sums.

        Raises:
            InputError: the file cannot be written.
        """
        header = {"name": view_name, "camera": view.camera_digest, "labels": view.labels_digest}
        self._keep(_view_stem(view_name), header, view.arrays())

    def remove(self, view_name: str) -> None:
        """Remove a view.

        Raises:
            InputError: there is none of this name, or its file cannot be removed.
        """
        self._require(view_name)
        self._unlink(_view_stem(view_name))
        del self.views[view_name]

    def remove_codes(self) -> None:
        """Remove the codes that are kept beside the sums."""
        if self.codes is not None:
            self._unlink(CODES)
            self.codes = None

    def keep_codes(self, header: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
        """Keep the codes of the regions beside the sums, as JSON values and tensors."""
        self._keep(CODES, header, _arrays(tensors))

    def keep_inputs(self, header: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
        """Keep what a merge has to know of the views beside the sums, as JSON values and tensors."""
        self._keep(INPUTS, header, _arrays(tensors))

    def is_like(self, other: RegionSums) -> bool:
        """Whether others are of the same Gaussians and levels, made and kept in the same way."""
        return self._header() == other._header() and torch.equal(self.order, other.order)

    @classmethod
    def joined(cls, parts: Sequence[RegionSums], holders: Mapping[str, RegionSums]) -> RegionSums:
        """Sums of the views of several, sharing their memory and files; nothing can be added to them.

        Args:
            parts: which are alike (``is_like``).
            holders: the one that each view is taken from, in the order of the views.
        """
        whole = copy.copy(parts[0])
        whole.views = {name: part._require(name) for name, part in holders.items()}
        whole.rows = whole.codes = whole.inputs = None
        whole.path, whole.writable = None, False
        whole._bytes = {str(number): part.bytes for number, part in enumerate(parts)}
        return whole

    def of_views(self, view_names: Iterable[str], rows: Rows) -> RegionSums:
        """The same sums of some views only, sharing memory, with the rows of these views.

        Raises:
            InputError: there are no sums of a view.
        """
        part = copy.copy(self)
        part.views = {name: self._require(name) for name in view_names}
        part.rows = rows
        return part

    def matrix(self, level: int, rows: Mapping[str, slice] | None = None) -> csr_array:
        """A [N, R] of one level as a scipy CSR matrix, float32; R counts the regions of all views.

        Args:
            level: position of the level.
            rows: of each view among all regions; by default those that ``region_sums`` has kept.
        """
        if rows is None:
            if self.rows is None:
                raise InputError("the rows of each view are not known; give them (Regions.embeddings)")
            rows = self.rows[level]
        views = {name: self.views[name] for name in rows if name in self.views}
        return csr_matrix(views, self.order.numpy(), level, rows)

    def triplets(
        self, view_name: str, level: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
        """(gaussian, region, weight) [T] of a view and level: rows of the scene, sorted, each pair once; an InputError
        where entries point outside."""
        return triplets_of(self.views[view_name], self.order.numpy(), level)

    # ---- within

    def _header(self) -> dict[str, Any]:
        return {
            "version": VERSION,
            "fingerprint": self.fingerprint,
            "levels": list(self.levels),
            "raster_preset": self.raster_preset,
            "weights": self.weights,
            "least_weight": self.least_weight,
        }

    def _check_writable(self) -> None:
        if not self.writable:
            raise InputError(f"{self.path or 'region sums of several folders'}: was opened for reading only")

    def _unlink(self, stem: str) -> None:
        self._check_writable()
        if self.path is not None:
            file = self.path / _file(stem)
            try:
                file.unlink()
            except OSError as error:
                raise WriteError.of(file, error) from error
        del self._bytes[stem]

    def _keep(self, stem: str, header: dict[str, Any], arrays: Mapping[str, NDArray[Any]]) -> None:
        """Write a file, or keep its contents in memory, and take it up."""
        self._check_writable()
        if self.path is None:
            kept = {name: np.array(array) for name, array in arrays.items()}
            self._apply(stem, StoredArrays(header, kept, sum(array.nbytes for array in kept.values())))
            return
        if not self._bytes:
            try:
                self.path.mkdir(parents=True)
            except OSError as error:
                raise WriteError.of(self.path, error) from error
            order = {"order": self.order.int().numpy()}
            self._bytes[SCENE] = write_arrays(self.path / _file(SCENE), self._header(), order)
        write_arrays(self.path / _file(stem), header, arrays)
        self._take(stem, self.path / _file(stem))

    def _take(self, stem: str, file: Path) -> None:
        stored = read_arrays(file)
        with _nonsense_named(file):
            self._apply(stem, stored)

    def _apply(self, stem: str, stored: StoredArrays) -> None:
        """Take up what is in a file."""
        if stem in (CODES, INPUTS):
            tensors = {name: torch.from_numpy(np.array(part)) for name, part in stored.arrays.items()}
            setattr(self, stem, {"header": stored.header, "tensors": tensors})
        else:
            view, name = ViewRecord.of_arrays(stored.header, stored.arrays), str(stored.header["name"])
            for part in view.parts:
                part.check(len(self.levels), np.dtype(self.weights))
            if stem != _view_stem(name):
                raise ValueError(f"it is of the view {name!r}, which has another file")
            self.views.pop(name, None)  # the order is that in which they were added
            self.views[name] = view
        self._bytes[stem] = stored.bytes

    def _require(self, view_name: str) -> ViewRecord:
        if view_name not in self.views:
            raise InputError(f"there are no region sums of the view {view_name!r}")
        return self.views[view_name]


@contextmanager
def _nonsense_named(file: Path) -> Iterator[None]:
    """Failures to make something of a file become a FileFormatError that names it."""
    try:
        yield
    except (KeyError, TypeError, ValueError, OverflowError, AttributeError) as error:
        if isinstance(error, (FileFormatError, WriteError)):
            raise
        reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise FileFormatError(file, f"makes no sense ({reason})", "make the region sums again") from error


def _file(stem: str) -> str:
    return stem + ENDING


def view_file(view_name: str) -> str:
    """Return the name of a view's file in the folder."""
    return _file(_view_stem(view_name))


def _view_stem(view_name: str) -> str:
    """The name without its ending: readable, and of this view alone."""
    return f"{_VIEW}{slug(view_name)}.{hashlib.sha256(view_name.encode()).hexdigest()[:12]}"


def _arrays(tensors: Mapping[str, Tensor]) -> dict[str, NDArray[Any]]:
    return {name: tensor.cpu().contiguous().numpy() for name, tensor in tensors.items()}


def bytes_of(path: Path) -> int:
    """Return how many bytes kept sums take on the disk."""
    return sum(file.stat().st_size for file in path.glob(f"[!.]*{ENDING}"))


def shard_path(field: Path, share: Share) -> Path:
    """Where a shard of a field's views is kept: beside it."""
    return field.with_name(f"{field.name}.{share}.sums")


def sums_path(field: Path) -> Path:
    """Where the region sums of a field are kept: beside it."""
    return field.with_name(field.name + ".sums")
