"""The region sums of all views: how much each Gaussian paints of each region, made once (method.md, stage 2).

Everything after rasterising reads only these: codes, rounds of the vote, other embeddings, more or fewer views. They
grow view by view, in memory or in a file, and a view that was added stays: a file is the checkpoint of a build.
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

from scoup.base.errors import FileFormatError, InputError, check_format_version
from scoup.base.shares import Share
from scoup.raster import ViewSums, morton_order
from scoup.scene.cameras import Camera
from scoup.scene.gaussians import Gaussians
from scoup.uplift.storage.entries import BUCKET, ViewRecord
from scoup.uplift.storage.matrices import csr_matrix, triplets_of
from scoup.uplift.storage.packing import Packer
from scoup.uplift.storage.record_file import Record, RecordFile, bytes_of
from scoup.uplift.storage.store import MOST_IN_MEMORY, Store, Stores

if TYPE_CHECKING:
    from scipy.sparse import csr_array

VERSION = 1
SUMS, VIEW, REMOVED, CODES, INPUTS = "region sums", "view", "removed", "codes", "inputs"

Rows = Sequence[Mapping[str, slice]]
"""Per level, the rows of each view in the stacked embeddings (``Regions.embeddings``)."""


class RegionSums:
    """The region sums of views of one scene, appended one after another.

    Gaussians are kept in Morton order, whatever backend made the sums.

    Args:
        fingerprint: of the Gaussians.
        order: [N] int64, the row of the scene that each Gaussian here is.
        levels: level names.
        raster_preset: rasteriser constants.
        path: keep them in this new file, which must not exist; None keeps them in memory, beyond ``most_in_memory``
            bytes in a temporary file.
        weights: "float32", or "float16" for less space.
        least_weight: entries below are left out; 0 keeps all.

    Attributes:
        views: by name, in the order in which they were added.
        rows: see ``Rows``; known where ``region_sums`` made them. ``matrix`` needs them.
        codes: what ``keep_codes`` was given last, None before.
        inputs: the same of ``keep_inputs``.
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
        most_in_memory: int = MOST_IN_MEMORY,
    ) -> None:
        if weights not in ("float32", "float16"):
            raise InputError(f"weights of region sums are float32 or float16, not {weights!r}")
        if not 0 <= least_weight < 1:
            raise InputError(f"the least weight of an entry must be 0 to 1, got {least_weight}")
        self.fingerprint = fingerprint
        self.order = order.cpu()
        self.levels = tuple(levels)
        self.raster_preset = raster_preset
        self.weights = weights
        self.least_weight = least_weight
        self.views: dict[str, ViewRecord] = {}
        self.rows: Rows | None = None
        self.codes: dict[str, Any] | None = None
        self.inputs: dict[str, Any] | None = None
        self._packer = Packer(self.order, weights, least_weight)
        if path is not None and path.exists():
            raise InputError(f"{path}: is there already; open it, or name another file")
        head = Record(SUMS, self._header(), {"order": self.order.int().numpy()})
        self._store: Store | Stores = Store(path, head, most_in_memory)

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
        """Sums that were kept in a file. All of it is read once, to compare checksums.

        Args:
            path: the file.
            writable: views can be appended to the file; what an interruption had cut short is cut off.

        Raises:
            MissingFileError, FileFormatError: there is no such file, it is another one, damaged, or of a newer version.
        """
        path = Path(path)
        file = RecordFile.open(path, writable)
        first = file.records[0]
        try:
            if first.kind != SUMS:
                raise ValueError(f"it begins with {first.kind!r}")
            check_format_version(path, first.header["version"], VERSION)
            order = torch.from_numpy(first.arrays["order"].astype(np.int64))
            if order.dim() != 1 or not torch.equal(order.sort().values, torch.arange(len(order))):
                raise ValueError("an order that lacks Gaussians")
            sums = cls(
                str(first.header["fingerprint"]),
                order,
                [str(level) for level in first.header["levels"]],
                str(first.header["raster_preset"]),
                weights=str(first.header["weights"]),
                least_weight=float(first.header["least_weight"]),
            )
            sums._store = Store.of_file(file)
            for record in file.records[1:]:
                sums._apply(record)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            file.close()
            if isinstance(error, FileFormatError):
                raise
            reason = f"lacks {error}" if isinstance(error, KeyError) else str(error)
            raise FileFormatError(path, f"makes no sense ({reason})", "make the region sums again") from error
        return sums

    # ---- what they are

    @property
    def n_gaussians(self) -> int:
        return len(self.order)

    @property
    def n_buckets(self) -> int:
        return -(-self.n_gaussians // BUCKET)

    @property
    def path(self) -> Path | None:
        """The file they are, or will be, kept in; None in memory."""
        return self._store.path

    @property
    def writable(self) -> bool:
        """Whether views can be appended."""
        return self._store.writable

    @property
    def bytes(self) -> int:
        """What they take, in memory and on disk."""
        return self._store.bytes

    @property
    def bytes_in_memory(self) -> int:
        """What they take in memory alone."""
        return self._store.bytes_in_memory

    @property
    def bytes_unused(self) -> int:
        """About how many of ``bytes`` are of replaced and removed views and of earlier codes, until ``compact``."""
        used = sum(bytes_of(record.arrays.values()) for record in self._living())
        return self.bytes - used - (0 if self.path is None else 4 * self.n_gaussians)

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
        self.append_record(
            view_name, ViewRecord(digest, sums.labels_digest, tuple(self._packer.entries(sums, order)))
        )

    def append_record(self, view_name: str, view: ViewRecord) -> None:
        """Add or replace a view by entries of these Gaussians that are known, in the order of these sums.

        Raises:
            InputError: the file cannot be written.
        """
        self._apply(self._store.append(VIEW, _view_header(view_name, view), view.arrays()))

    def remove(self, view_name: str) -> None:
        """Forget a view.

        Raises:
            InputError: there is none of this name, or the file cannot be written.
        """
        self._require(view_name)
        self._apply(self._store.append(REMOVED, {"name": view_name}, {}))

    def keep_codes(self, header: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
        """Keep the codes of the regions beside the sums, as JSON values and tensors."""
        self._keep(CODES, header, tensors)

    def keep_inputs(self, header: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
        """Keep what a merge has to know of the views beside the sums, as JSON values and tensors."""
        self._keep(INPUTS, header, tensors)

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
        whole._store = Stores([part._store for part in parts])
        return whole

    def compact(self) -> None:
        """Give back what replaced and removed views, and earlier codes, still take. A file of a name is written anew,
        as one that never held them would be, and replaced as a whole.

        Raises:
            InputError: the file cannot be written, or was opened for reading only.
        """
        if not isinstance(self._store, Store) or not self.writable:
            raise InputError(f"{self.path}: was opened for reading only")
        self._store, records = self._store.with_only(self._living())
        self.views = {}
        for record in records:
            self._apply(record)

    def of_views(self, view_names: Iterable[str], rows: Rows) -> RegionSums:
        """The same sums of some views only, sharing memory, with the rows of these views.

        Raises:
            InputError: there are no sums of a view.
        """
        part = copy.copy(self)
        part.views = {name: self._require(name) for name in view_names}
        part.rows = rows
        return part

    def forget_pages(self) -> None:
        """See ``RecordFile.forget_pages``."""
        self._store.forget_pages()

    def close(self) -> None:
        """Close the file, if there is one."""
        self._store.close()

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

    def _keep(self, kind: str, header: dict[str, Any], tensors: Mapping[str, Tensor]) -> None:
        self._apply(self._store.append(kind, header, _arrays(tensors)))

    def _living(self) -> list[Record]:
        """The records that say all that counts: the views in the order in which they were added, what was kept."""
        records = [Record(VIEW, _view_header(name, view), view.arrays()) for name, view in self.views.items()]
        for kind, kept in ((CODES, self.codes), (INPUTS, self.inputs)):
            if kept is not None:
                records.append(Record(kind, kept["header"], _arrays(kept["tensors"])))
        return records

    def _apply(self, record: Record) -> None:
        """What a record changes."""
        if record.kind == VIEW:
            view = ViewRecord.of_arrays(record.header, record.arrays)
            for part in view.parts:
                part.check(len(self.levels), np.dtype(self.weights))
            name = str(record.header["name"])
            self.views.pop(name, None)  # the order is that in which they were added
            self.views[name] = view
        elif record.kind == REMOVED:
            self.views.pop(str(record.header["name"]), None)
        elif record.kind in (CODES, INPUTS):
            tensors = {name: torch.from_numpy(np.array(part)) for name, part in record.arrays.items()}
            setattr(self, record.kind, {"header": record.header, "tensors": tensors})
        else:
            raise ValueError(f"a record of the kind {record.kind!r}")

    def _require(self, view_name: str) -> ViewRecord:
        if view_name not in self.views:
            raise InputError(f"there are no region sums of the view {view_name!r}")
        return self.views[view_name]


def _view_header(view_name: str, view: ViewRecord) -> dict[str, Any]:
    return {"name": view_name, "camera": view.camera_digest, "labels": view.labels_digest}


def _arrays(tensors: Mapping[str, Tensor]) -> dict[str, NDArray[Any]]:
    return {name: tensor.cpu().contiguous().numpy() for name, tensor in tensors.items()}


def shard_path(field: Path, share: Share) -> Path:
    """Where a shard of a field's views is kept: beside it."""
    return field.with_name(f"{field.name}.{share}.sums")


def sums_path(field: Path) -> Path:
    """Where the region sums of a field are kept: beside it."""
    return field.with_name(field.name + ".sums")
