"""The region sums of all views: what each Gaussian contributes to each region, made once (method.md, stage 2).

Everything after rasterising reads only these: codes, rounds of the vote, other embeddings, more or fewer views. They
grow view by view, in memory or in a folder with one file per view, to which several processes may add views.
"""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import (
    FileFormatError,
    InputError,
    MissingFileError,
    OutputExistsError,
    ScoupWarning,
    SealedFile,
    WriteError,
    check_format_version,
    flush_to_disk,
    invalid_contents,
)
from scoup.raster import ViewSums, morton_order
from scoup.scene import Camera, Gaussians
from scoup.uplift.settings import Scale, check_scale
from scoup.uplift.storage.array_file import (
    ENDING,
    SCENE,
    StoredArrays,
    read_arrays,
    stored_files,
    view_file,
)
from scoup.uplift.storage.entries import BUCKET, Packer, ViewRecord

if TYPE_CHECKING:
    from scipy.sparse import csr_array

VERSION = 1
_INVALID = "is invalid", "make the region sums again"

Rows = Sequence[Mapping[str, slice]]
"""Per level, the rows of each view in the stacked embeddings (``Regions.embeddings``)."""


class RegionSums:
    """The region sums of views of one scene, added one by one.

    Gaussians are kept in Morton order, whatever backend made the sums.

    Args:
        fingerprint: of the Gaussians.
        order: [N] int64, row in the scene of each Gaussian here.
        levels: level names.
        raster_preset: rasteriser constants.
        path: keep them in this folder, which is made with the first view, or by another process that adds views of the
            same scene; None keeps them in memory.
        means: [N, 3] float32 of the Gaussians here, by which things lose strays; None if unknown.
        scale: of the images, as in ``BuildSettings``.

    Attributes:
        path: folder they are, or will be, kept in; None in memory.
        writable: whether views can be added.
        views: view name -> entries.
        bytes: size in memory or on disk.

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
        means: Tensor | None = None,
        scale: Scale = "auto",
    ) -> None:
        check_scale(scale)
        self.path = path
        self.writable = True
        self.bytes = 0
        self.fingerprint = fingerprint
        self.order = order.cpu()
        self.levels = tuple(levels)
        self.raster_preset = raster_preset
        self.means = means
        self.scale: Scale = scale
        self.views: dict[str, ViewRecord] = {}
        self._rows: Rows | Callable[[], Rows] | None = None
        self._packer = Packer(self.order)
        self._unflushed: list[Path] = []  # of all sums that are selected from these: one folder

    @classmethod
    def empty(
        cls,
        gaussians: Gaussians,
        levels: Sequence[str],
        raster_preset: str = "inria",
        path: Path | None = None,
        scale: Scale = "auto",
    ) -> RegionSums:
        """Return sums of a scene without views; arguments as of the class."""
        order = morton_order(gaussians.means).cpu()
        means = gaussians.means.cpu()[order]
        return cls(gaussians.fingerprint(), order, levels, raster_preset, path, means, scale)

    @staticmethod
    def are_in(path: Path) -> bool:
        """Return whether a folder contains region sums."""
        return (path / f"{SCENE}{ENDING}").exists()

    @classmethod
    def open(cls, path: str | Path, writable: bool = False) -> RegionSums:
        """Open kept sums, with their views in order of name. All bytes are read once, to compare checksums.

        Args:
            path: the folder.
            writable: views can be added. Damaged views are omitted, with a warning, to be made again.

        Raises:
            MissingFileError, FileFormatError: missing, not region sums, damaged, or of a newer version.

        Warns:
            ScoupWarning: damaged views are omitted.
        """
        path = Path(path)
        scene = path / f"{SCENE}{ENDING}"
        if not scene.is_file():
            problem = "is not a folder of region sums" if path.exists() else "there is no such folder"
            raise MissingFileError(path, problem, "check the path")
        head = read_arrays(scene)
        with invalid_contents(scene, *_INVALID):
            check_format_version(scene, head.header["version"], VERSION)
            order = torch.from_numpy(head.arrays["order"].astype(np.int64))
            if order.dim() != 1 or not torch.equal(order.sort().values, torch.arange(len(order))):
                raise ValueError("an order that lacks Gaussians")
            means = head.arrays.get("means")
            if means is not None and (means.dtype, means.shape) != (np.float32, (len(order), 3)):
                raise ValueError("means of other Gaussians")
            sums = cls(
                str(head.header["fingerprint"]),
                order,
                [str(level) for level in head.header["levels"]],
                str(head.header["raster_preset"]),
                means=None if means is None else torch.from_numpy(np.array(means)),
                scale=head.header["scale"],
            )
        sums.path, sums.writable, sums.bytes = path, writable, head.bytes
        for file in stored_files(path):
            if file == scene:
                continue
            try:
                sums._load(file)
            except FileFormatError as error:
                if not writable:
                    raise
                warnings.warn(f"{error}; it is made again", ScoupWarning, stacklevel=2)
        sums.views = dict(sorted(sums.views.items()))
        return sums

    @property
    def n_gaussians(self) -> int:
        return len(self.order)

    @property
    def rows(self) -> Rows | None:
        """See ``Rows``; None unless ``region_sums`` or ``select`` made these sums."""
        if callable(self._rows):
            self._rows = self._rows()
        return self._rows

    @rows.setter
    def rows(self, rows: Rows | None) -> None:
        self._rows = rows

    @property
    def n_buckets(self) -> int:
        return -(-self.n_gaussians // BUCKET)

    def __contains__(self, view_name: str) -> bool:
        return view_name in self.views

    def __len__(self) -> int:
        return len(self.views)

    def n_regions(self, view_name: str) -> list[int]:
        """Return [S], the highest region that an entry of a view can have at each level, plus one."""
        tables = [entries.table for entries in self._require(view_name).parts]
        highest = np.max([table.max(0, initial=-1) for table in tables], axis=0)
        return (highest + 1).tolist()

    def stored_size(self) -> tuple[int, int]:
        """Return the number of views in the folder, also those that other processes added, and the bytes of all its
        files."""
        files = [] if self.path is None else stored_files(self.path)
        return sum(file.stem != SCENE for file in files), sum(file.stat().st_size for file in files)

    def describe(self) -> dict[str, Any]:
        """Return the facts as JSON values."""
        return {
            "kind": "region sums",
            "gaussians": self.n_gaussians,
            "levels": list(self.levels),
            "raster_preset": self.raster_preset,
            "scale": self.scale,
            "views": len(self),
            "bytes": self.bytes,
            "fingerprint": self.fingerprint,
        }

    def append(
        self, view_name: str, sums: ViewSums, camera: Camera | None = None, order: Tensor | None = None
    ) -> None:
        """Add a view, or replace the one of this name.

        Args:
            view_name: its name.
            sums: from ``raster.region_sums``.
            camera: its camera; later builds compare theirs with it.
            order: row in the scene of each rasterised Gaussian; None if they are in the scene's order.

        Raises:
            InputError: the sums are of another scene, or the file cannot be written.
        """
        if sums.table.shape[1] != len(self.levels):
            raise InputError(
                f"{view_name!r}: sums of {sums.table.shape[1]} levels, not of {list(self.levels)}"
            )
        digest = "" if camera is None else camera.fingerprint()
        header = {"name": view_name, "camera": digest, "labels": sums.labels_digest}
        view = ViewRecord(digest, sums.labels_digest, tuple(self._packer.entries(sums, order)))
        if not self.writable:
            raise InputError(f"{self.path}: opened for reading only")
        if self.path is None:
            arrays = {name: np.array(array) for name, array in view.arrays().items()}
            self._add(StoredArrays(header, arrays, sum(array.nbytes for array in arrays.values())))
            return
        if not self.bytes:
            self._make_folder(self.path)
        file = self.path / view_file(view_name)
        # Not flushed one by one: the folder is (``flush``), and checksums detect the rest.
        SealedFile.write(file, header, view.arrays(), overwrite=True, flush=False, wait=True)
        self._unflushed.append(file)
        self._load(file, written=True)

    def flush(self) -> None:
        """Write the files of new views to the disk, so that a power cut loses none."""
        flush_to_disk(*self._unflushed)
        self._unflushed.clear()

    def select(self, view_names: Iterable[str], rows: Rows | Callable[[], Rows]) -> RegionSums:
        """Return the sums of some views, sharing memory, with the rows of these views, or a function that makes them
        on first use."""
        selection = copy.copy(self)
        selection.views = {name: self._require(name) for name in view_names}
        selection._rows = rows
        return selection

    def matrix(self, level: int, rows: Mapping[str, slice] | None = None) -> csr_array:
        """Return A [N, R] of one level as a scipy CSR matrix, float32; R counts the regions of all views.

        Args:
            level: position of the level.
            rows: of each view among all regions; by default ``self.rows``.
        """
        from scipy.sparse import coo_array

        if rows is None:
            if self.rows is None:
                raise InputError("the rows of each view are not known; pass rows (Regions.embeddings)")
            rows = self.rows[level]
        parts = [(np.zeros(0, np.int32), np.zeros(0, np.int32), np.zeros(0, np.float32))]
        for name, span in rows.items():
            if name in self.views:
                gaussian, region, weight = self.triplets(name, level)
                parts.append((gaussian.astype(np.int32), (region + span.start).astype(np.int32), weight))
        gaussians, regions, weights = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        shape = self.n_gaussians, max((span.stop for span in rows.values()), default=0)
        return coo_array((weights, (gaussians, regions)), shape).tocsr()

    def triplets(
        self, view_name: str, level: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
        """Return (gaussian, region, weight) [T] of a view and level: rows of the scene, sorted, each pair once; an
        InputError if entries point outside."""
        order, parts = self.order.numpy(), []
        for entries in self.views[view_name].parts:
            entries.check_numbers(len(order))
            region = entries.table[:, level][entries.combinations].astype(np.int64)
            there = region >= 0
            with np.errstate(all="ignore"):  # a damaged weight may be NaN
                weight = entries.weights[there].astype(np.float64)
            parts.append((order[entries.gaussians()[there]], region[there], weight))
        gaussian, region, weight = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        stride = int(region.max(initial=0)) + 1
        keys, inverse = np.unique(gaussian * stride + region, return_inverse=True)
        with np.errstate(all="ignore"):  # or too large
            total = np.bincount(inverse, weight, len(keys)).astype(np.float32)
        return keys // stride, keys % stride, total

    def _make_folder(self, path: Path) -> None:
        """Make the folder with the file of the scene, unless another process has just done so."""
        scene = path / f"{SCENE}{ENDING}"
        header = {
            "version": VERSION,
            "fingerprint": self.fingerprint,
            "levels": list(self.levels),
            "raster_preset": self.raster_preset,
            "scale": self.scale,
        }
        arrays = {"order": self.order.int().numpy()}
        if self.means is not None:
            arrays["means"] = self.means.contiguous().numpy()
        try:
            path.mkdir(parents=True, exist_ok=True)
            self.bytes = SealedFile.write(scene, header, arrays, flush=False, wait=True)
            self._unflushed.append(scene)
        except OutputExistsError:
            stored = read_arrays(scene)
            if {name: stored.header.get(name) for name in header} != header:
                raise InputError(
                    f"{path}: another process adds views of another scene; use another folder"
                ) from None
            self.bytes = stored.bytes
        except OSError as error:
            raise WriteError.of(path, error) from error

    def _load(self, file: Path, written: bool = False) -> None:
        stored = read_arrays(file, written)
        with invalid_contents(file, *_INVALID):
            if file.name != view_file(str(stored.header["name"])):
                raise ValueError(f"it is of the view {stored.header['name']!r}, which has another file")
            self._add(stored)

    def _add(self, stored: StoredArrays) -> None:
        view = ViewRecord.from_arrays(stored.header, stored.arrays, stored.bytes)
        name = str(stored.header["name"])
        for entries in view.parts:
            entries.check(len(self.levels))
        before = self.views.pop(name, None)  # views are in the order in which they were added
        self.views[name] = view
        self.bytes += view.bytes - (before.bytes if before else 0)

    def _require(self, view_name: str) -> ViewRecord:
        if view_name not in self.views:
            raise InputError(f"there are no region sums of the view {view_name!r}")
        return self.views[view_name]
