"""Where an interrupted ``build`` left off: codebooks and codes once learned, accumulators, views done."""

from __future__ import annotations

import hashlib
import json
import time
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, TypeAlias

import torch
from torch import Tensor

from scoup import __version__
from scoup.agreement import Agreement
from scoup.artefact import read_tensors, write_tensors
from scoup.cameras import Camera
from scoup.codes import SparseCodes
from scoup.errors import FileFormatError, ScoupWarning

SECONDS_BETWEEN_WRITES = 30.0
WRITES_SHARE = 0.05  # of the time may go into writing
_SCHEMA = "scoup.build_checkpoint"
_AGREEMENT = ("indices", "weights", "grams", "sharpness")

Embeddings: TypeAlias = tuple[Tensor, dict[str, slice]]
"""All embeddings of a level [R, D], and the rows of each view in them."""


@dataclass(eq=False)
class BuildState:
    """What a build has so far. ``accumulators`` [N, S, L] change in place as views are added.

    Attributes:
        atoms: per level [L, D].
        codes: per level, the codes of all regions.
        reports: per level, the coding report as JSON values.
        accumulators: [N, S, L] float32.
        views_done: names of the views already added in this round, each with the digest of its label maps.
        rounds_done: rounds of the vote that are over.
        agreement: outcome of the last of those, None in the first round. Its rows are in the accumulators' order.
        earlier_views: ``views_done`` of the last of those.
        between_views: false while a view is being added; such a state is never stored.
    """

    atoms: list[Tensor]
    codes: list[SparseCodes]
    reports: list[dict[str, Any]]
    accumulators: Tensor
    views_done: dict[str, str]
    rounds_done: int = 0
    agreement: Agreement | None = None
    earlier_views: dict[str, str] = field(default_factory=dict)
    between_views: bool = True

    def to(self, device: torch.device, accumulators: torch.device) -> BuildState:
        """The same with codes on one device, accumulators and what is compared with them on another."""
        return replace(
            self,
            atoms=[atoms.to(device) for atoms in self.atoms],
            codes=[codes.to(device) for codes in self.codes],
            accumulators=self.accumulators.to(accumulators),
            agreement=None if self.agreement is None else self.agreement.to(accumulators),
        )

    def start_over(self) -> None:
        """Forget all views, keep the codes."""
        self.accumulators.zero_()
        self.views_done.clear()
        self.rounds_done, self.agreement, self.earlier_views = 0, None, {}

    def end_round(self, agreement: Agreement) -> None:
        """Keep the outcome of a round and make ready for the next."""
        self.accumulators.zero_()
        self.earlier_views, self.views_done = self.views_done, {}
        self.rounds_done += 1
        self.agreement = agreement


class Checkpoint:
    """Keeps a build's state in a file, written at most every ``SECONDS_BETWEEN_WRITES``.

    Args:
        path: the file; None keeps nothing.
        key: hash of everything the result depends on; a file with another key is not used.
        rows_order: name of the order in which the accumulators' rows are. Of a file with another one, only the codes
            are used.
    """

    def __init__(self, path: Path | None, key: str, rows_order: str = "original") -> None:
        self.path = path
        self.key = key
        self.rows_order = rows_order
        self._written = time.monotonic()
        self._seconds_of_write = 0.0

    def read(self, shape: tuple[int, int, int]) -> BuildState | None:
        """The stored state, or None where there is none of this very build.

        Args:
            shape: N, S, L of the build's accumulators.
        """
        if self.path is None or not self.path.is_file():
            return None
        try:
            tensors, header = read_tensors(self.path, _SCHEMA, "a build checkpoint")
            if header["key"] != self.key:
                return None
            levels = range(len(header["reports"]))
            views, earlier = (
                {str(name): str(digest) for name, digest in header[kind].items()}
                for kind in ("views_done", "earlier_views")
            )
            rounds_done = int(header["rounds_done"])
            if header["rows_order"] != self.rows_order:
                views, rounds_done = {}, 0  # another backend worked on it
            agreement = None
            if rounds_done:
                parts = (tensors[f"agreement.{name}"] for name in _AGREEMENT)
                agreement = Agreement(*parts)
                if tuple(agreement.indices.shape[:2]) != shape[:2] or agreement.n_atoms != shape[2]:
                    raise ValueError(f"an earlier round of other codes {list(agreement.indices.shape)}")
            accumulators = tensors["accumulators"] if views else torch.zeros(shape)
            if tuple(accumulators.shape) != shape:
                raise ValueError(f"accumulators {list(accumulators.shape)} are not {list(shape)}")
            n_atoms = shape[2]
            codes = [SparseCodes(tensors[f"indices.{s}"], tensors[f"weights.{s}"], n_atoms) for s in levels]
            atoms = [tensors[f"atoms.{s}"] for s in levels]
            return BuildState(
                atoms,
                codes,
                header["reports"],
                accumulators,
                views,
                rounds_done,
                agreement,
                earlier if rounds_done else {},
            )
        except (FileFormatError, KeyError, ValueError, IndexError, TypeError, AttributeError) as error:
            warnings.warn(
                f"{self.path}: the checkpoint cannot be used ({error}); starting over",
                ScoupWarning,
                stacklevel=2,
            )
            return None

    def is_due(self) -> bool:
        """Whether enough time has gone by since the last write."""
        pause = max(SECONDS_BETWEEN_WRITES, self._seconds_of_write / WRITES_SHARE)
        return self.path is not None and time.monotonic() - self._written > pause

    def write(self, state: BuildState) -> None:
        """Store the state, unless it is in the middle of a view."""
        if self.path is None or not state.between_views:
            return
        started = time.monotonic()
        # Before the first view the accumulators are all zero, and large.
        tensors = {"accumulators": state.accumulators} if state.views_done else {}
        for s, codes in enumerate(state.codes):
            tensors |= {
                f"atoms.{s}": state.atoms[s],
                f"indices.{s}": codes.indices,
                f"weights.{s}": codes.weights,
            }
        if state.agreement is not None:
            tensors |= {f"agreement.{name}": getattr(state.agreement, name) for name in _AGREEMENT}
        header = {
            "key": self.key,
            "rounds_done": state.rounds_done,
            "reports": state.reports,
            "views_done": state.views_done,
            "earlier_views": state.earlier_views,
            "rows_order": self.rows_order,
        }
        write_tensors(self.path, tensors, _SCHEMA, header)
        self._written = time.monotonic()
        self._seconds_of_write = self._written - started

    def remove(self) -> None:
        """Forget the state: the result is safe elsewhere."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)


def build_key(
    fingerprint: str, cameras: Sequence[Camera], embeddings: dict[str, Embeddings], settings: dict[str, Any]
) -> str:
    """SHA-256 over everything a build's result depends on but the label maps, which are hashed view by view.

    Args:
        fingerprint: of the Gaussians.
        cameras: the views.
        embeddings: per level, as from ``Regions.embeddings``.
        settings: plain JSON values.
    """
    digest = hashlib.sha256(json.dumps([__version__, fingerprint, settings], sort_keys=True).encode())
    for camera in cameras:
        digest.update(json.dumps([camera.name, camera.width, camera.height, camera.distortion]).encode())
        digest.update(torch.cat([camera.viewmat.flatten(), camera.K.flatten()]).numpy().tobytes())
    for level, (rows, of_views) in embeddings.items():
        ends = {name: of_view.stop for name, of_view in of_views.items()}
        digest.update(json.dumps([level, list(rows.shape), ends]).encode())
        digest.update(rows.contiguous().numpy().tobytes())
    return digest.hexdigest()
