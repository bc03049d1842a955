"""The region sums of all views: what each Gaussian contributes to each region, made once (method.md, stage 2).

Everything after rasterising reads only these: codes, rounds of the vote, other embeddings, more or fewer views. They
grow view by view, in memory or in a folder with one file per view: a checkpoint of a build, kept sums, a shard.
"""

from __future__ import annotations

import copy
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base.atomic import remove
from scoup.base.errors import InputError, MissingFileError, check_format_version
from scoup.raster import ViewSums, morton_order
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.uplift.storage.array_file import StoredArrays, read_arrays
from scoup.uplift.storage.array_folder import ArrayFolder, Arrays, report_damage
from scoup.uplift.storage.entries import BUCKET, ViewRecord
from scoup.uplift.storage.matrices import csr_matrix, triplets_of
from scoup.uplift.storage.packing import Packer
from scoup.uplift.storage.paths import CODES, ENDING, INPUTS, SCENE, view_stem

if TYPE_CHECKING:
    from scipy.sparse import csr_array

VERSION = 1

Rows = Sequence[Mapping[str, slice]]
"""Per level, the rows of each view in the stacked embeddings (``Regions.embeddings``)."""


class RegionSums(ArrayFolder):
    """The region sums of views of one scene, added one by one.

    Gaussians are kept in Morton order, whatever backend made the sums.

    Args:
        fingerprint: of the Gaussians.
        order: [N] int64, row in the scene of each Gaussian here.
        levels: level names.
        raster_preset: rasteriser constants.
        path: keep them in this new folder, which is made with the first view; None keeps them in memory.
        weights: "float32", or "float16" for less space.
        least_weight: omit entries below; 0 keeps all.
        means: [N, 3] float32 of the Gaussians here, by which things lose strays; None if unknown.

    Attributes:
        path: folder they are, or will be, kept in; None in memory.
        writable: whether views can be added.
        views: view name -> entries.
        rows: see ``Rows``; None unless ``region_sums`` or ``select`` set them.
        codes: header and tensors given to ``keep_codes``, or None.
        inputs: header and tensors given to ``keep_inputs``, or None.

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
        means: Tensor | None = None,
    ) -> None:
        if weights not in ("float32", "float16"):
            raise InputError(f"weights of region sums must be float32 or float16, got {weights!r}")
        if not 0 <= least_weight < 1:
            raise InputError(f"the least weight of an entry must be 0 to 1, got {least_weight}")
        if path is not None and path.exists():
            raise InputError(f"{path}: already exists; open it, or use another folder")
        super().__init__(path)
        self.fingerprint = fingerprint
        self.order = order.cpu()
        self.levels = tuple(levels)
        self.raster_preset = raster_preset
        self.weights = weights
        self.least_weight = least_weight
        self.means = means
        self.views: dict[str, ViewRecord] = {}
        self.rows: Rows | None = None
        self.codes: dict[str, Any] | None = None
        self.inputs: dict[str, Any] | None = None
        self._packer = Packer(self.order, weights, least_weight)

    @classmethod
    def empty(
        cls, gaussians: Gaussians, levels: Sequence[str], raster_preset: str = "inria", **more: Any
    ) -> RegionSums:
        """Return sums of a scene without views; ``more`` are further arguments of the class."""
        order = morton_order(gaussians.means).cpu()
        means = gaussians.means.cpu()[order]
        return cls(gaussians.fingerprint(), order, levels, raster_preset, means=means, **more)

    @classmethod
    def empty_like(cls, other: RegionSums, path: Path | None = None) -> RegionSums:
        """Return sums without views that are compatible with others (``is_compatible``)."""
        kept_as = {"weights": other.weights, "least_weight": other.least_weight, "means": other.means}
        return cls(other.fingerprint, other.order, other.levels, other.raster_preset, path, **kept_as)

    @classmethod
    def open(cls, path: str | Path, writable: bool = False) -> RegionSums:
        """Open kept sums, with their views in order of name. All bytes are read once, to compare checksums.

        Args:
            path: the folder.
            writable: views can be added, by one process at a time. Removes what a killed process was writing.

        Raises:
            MissingFileError, FileFormatError: missing, not region sums, damaged, or of a newer version.
        """
        path = Path(path)
        scene = path / f"{SCENE}{ENDING}"
        if not scene.is_file():
            problem = "is not a folder of region sums" if path.exists() else "there is no such folder"
            raise MissingFileError(path, problem, "check the path")
        head = read_arrays(scene)
        with report_damage(scene):
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
                weights=str(head.header["weights"]),
                least_weight=float(head.header["least_weight"]),
                means=None if means is None else torch.from_numpy(np.array(means)),
            )
        sums.path, sums.writable, sums._bytes[SCENE] = path, writable, head.bytes
        for file in sorted(path.glob(f"*{ENDING}")):
            if file.name.startswith("."):
                if writable:
                    remove(file)
            elif file != scene:
                sums._load(file)
        sums.views = dict(sorted(sums.views.items()))
        return sums

    @property
    def n_gaussians(self) -> int:
        return len(self.order)

    @property
    def n_buckets(self) -> int:
        return -(-self.n_gaussians // BUCKET)

    @property
    def is_empty(self) -> bool:
        """Return whether no Gaussian contributes to a region of any view."""
        return not any(len(part.places) for view in self.views.values() for part in view.parts)

    def __contains__(self, view_name: str) -> bool:
        return view_name in self.views

    def __len__(self) -> int:
        return len(self.views)

    def n_regions(self, view_name: str) -> list[int]:
        """Return [S], the highest region that an entry of a view can have at each level, plus one."""
        tables = [part.table for part in self._require(view_name).parts]
        highest = np.max([table.max(0, initial=-1) for table in tables], axis=0)
        return (highest + 1).tolist()

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
        view = ViewRecord(digest, sums.labels_digest, tuple(self._packer.entries(sums, order)))
        self.append_record(view_name, view)

    def append_record(self, view_name: str, view: ViewRecord) -> None:
        """Add or replace a view by entries that are in the order of these sums already."""
        header = {"name": view_name, "camera": view.camera_digest, "labels": view.labels_digest}
        self._write(view_stem(view_name), header, view.arrays())

    def remove(self, view_name: str) -> None:
        """Remove a view; an InputError if it is missing, or its file cannot be removed."""
        self._require(view_name)
        self._unlink(view_stem(view_name))
        del self.views[view_name]

    def remove_codes(self) -> None:
        """Remove the codes kept beside the sums."""
        if self.codes is not None:
            self._unlink(CODES)
            self.codes = None

    def keep_codes(self, header: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
        """Keep the codes of the regions beside the sums."""
        self._write(CODES, header, _arrays(tensors))

    def keep_inputs(self, header: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
        """Keep what a merge needs to know of the views beside the sums."""
        self._write(INPUTS, header, _arrays(tensors))

    def is_compatible(self, other: RegionSums) -> bool:
        """Return whether others are of the same Gaussians and levels, made and kept in the same way."""
        return self._scene()[0] == other._scene()[0] and torch.equal(self.order, other.order)

    @classmethod
    def concatenate(cls, views: Mapping[str, RegionSums]) -> RegionSums:
        """Return read-only sums of views taken from several compatible ones, sharing memory and files."""
        parts = list(dict.fromkeys(views.values()))
        whole = copy.copy(parts[0])
        whole.views = {name: part._require(name) for name, part in views.items()}
        whole.rows = whole.codes = whole.inputs = None
        whole.path, whole.writable = None, False
        whole._bytes = {str(number): part.bytes for number, part in enumerate(parts)}
        return whole

    def select(self, view_names: Iterable[str], rows: Rows) -> RegionSums:
        """Return the sums of some views, sharing memory, with the rows of these views."""
        part = copy.copy(self)
        part.views = {name: self._require(name) for name in view_names}
        part.rows = rows
        return part

    def matrix(self, level: int, rows: Mapping[str, slice] | None = None) -> csr_array:
        """Return A [N, R] of one level as a scipy CSR matrix, float32; R counts the regions of all views.

        Args:
            level: position of the level.
            rows: of each view among all regions; by default ``self.rows``.
        """
        if rows is None:
            if self.rows is None:
                raise InputError("the rows of each view are not known; pass rows (Regions.embeddings)")
            rows = self.rows[level]
        views = {name: self.views[name] for name in rows if name in self.views}
        return csr_matrix(views, self.order.numpy(), level, rows)

    def triplets(
        self, view_name: str, level: int
    ) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float32]]:
        """Return (gaussian, region, weight) [T] of a view and level: rows of the scene, sorted, each pair once; an
        InputError if entries point outside."""
        return triplets_of(self.views[view_name], self.order.numpy(), level)

    def _scene(self) -> tuple[dict[str, Any], Arrays]:
        header = {
            "version": VERSION,
            "fingerprint": self.fingerprint,
            "levels": list(self.levels),
            "raster_preset": self.raster_preset,
            "weights": self.weights,
            "least_weight": self.least_weight,
        }
        arrays = {"order": self.order.int().numpy()}
        if self.means is not None:
            arrays["means"] = self.means.contiguous().numpy()
        return header, arrays

    def _apply(self, stem: str, stored: StoredArrays) -> None:
        if stem in (CODES, INPUTS):
            tensors = {name: torch.from_numpy(np.array(part)) for name, part in stored.arrays.items()}
            setattr(self, stem, {"header": stored.header, "tensors": tensors})
        else:
            view, name = ViewRecord.from_arrays(stored.header, stored.arrays), str(stored.header["name"])
            for part in view.parts:
                part.check(len(self.levels), np.dtype(self.weights))
            if stem != view_stem(name):
                raise ValueError(f"it is of the view {name!r}, which has another file")
            self.views.pop(name, None)  # views are in the order in which they were added
            self.views[name] = view
        self._bytes[stem] = stored.bytes

    def _require(self, view_name: str) -> ViewRecord:
        if view_name not in self.views:
            raise InputError(f"there are no region sums of the view {view_name!r}")
        return self.views[view_name]


def _arrays(tensors: Mapping[str, Tensor]) -> dict[str, NDArray[Any]]:
    return {name: tensor.cpu().contiguous().numpy() for name, tensor in tensors.items()}
