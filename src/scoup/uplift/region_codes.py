"""Embeddings and codes of the regions of all views; the vote multiplies the region sums with the codes."""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor

from scoup.base import VERSION, InputError, Progress, ScoupWarning, listed, no_progress
from scoup.coding import CodingReport, encode_rows, fit_codes, report_on
from scoup.scene import Cameras, Regions, SparseCodes, codes_problem, normalise_embeddings
from scoup.uplift.settings import BuildSettings, build_settings
from scoup.uplift.stored_sums import Rows

if TYPE_CHECKING:
    from scoup.field import Field

CODEBOOK_OF_FIELD = "codebook of a field"
"""In place of a solver's name in reports."""
MANY = 0.3
"""Share of a view's regions that are badly explained; about a tenth are where nothing is new."""


@dataclass(frozen=True, eq=False)
class RegionEmbeddings:
    """The embeddings of the regions of all views.

    Example:
        >>> regions = scoup.load_regions("scene", scoup.load_cameras("scene"))
        >>> len(scoup.RegionEmbeddings.load(regions).of_levels) == len(regions.levels)
        True
    """

    levels: tuple[str, ...]
    of_levels: Sequence[Tensor]  # S x [R, D] float32, one row per region of any view
    rows: Rows

    @classmethod
    def load(cls, regions: Regions) -> RegionEmbeddings:
        """Read the embeddings of all views of ``regions``."""
        if not len(regions):
            none: Rows = [{} for _ in regions.levels]
            return cls(regions.levels, [torch.zeros(0, 0) for _ in regions.levels], none)
        of_levels, rows = zip(*(regions.embeddings(level) for level in regions.levels), strict=True)
        return cls(regions.levels, of_levels, rows)

    def check(self) -> None:
        """Raise an InputError if they cannot be coded: a level is empty or all zero, or levels differ in size."""
        sizes = {level: rows.shape[1] for level, rows in zip(self.levels, self.of_levels, strict=True)}
        if len(set(sizes.values())) > 1:
            raise InputError(f"the levels have embeddings of different sizes {sizes}: they mix models")
        for level, rows in zip(self.levels, self.of_levels, strict=True):
            if not len(rows):
                raise InputError(f"level {level!r} has no regions in any view; every level needs some")
            if problem := codes_problem(rows.shape[1]):
                raise InputError(problem)
            if not rows.any():
                raise InputError(
                    f"level {level!r} has only zero embeddings, as the embedder colors makes of black photographs; "
                    "check the photographs, or extract the regions with a CLIP model"
                )


@dataclass(frozen=True, eq=False)
class RegionCodes:
    """One codebook and one set of codes per level."""

    codebook: Tensor  # [S, L, D] float32
    codes: Sequence[SparseCodes]  # per level, of the regions of all views
    rows: Rows
    reports: Sequence[dict[str, Any]]  # per level, report of the coding as JSON values


def code_regions(
    embeddings: RegionEmbeddings,
    settings: BuildSettings | str = "default",
    codebook: Field | None = None,
    device: torch.device | str = "cpu",
    progress: Progress = no_progress,
) -> RegionCodes:
    """Learn a codebook per level, and code the regions of all views by it (``fit_codes``); or code them by the codebook
    of an earlier field of the scene.

    Args:
        embeddings: of the regions.
        settings: those of coding count; with a codebook only ``k``.
        codebook: the earlier field.
        device: where the codes are made; they are returned on the CPU.
        progress: called for the stage "coding" of each level.

    Raises:
        InputError: a level has no embeddings that can be coded, or levels or sizes are not those of the codebook.

    Warns:
        ScoupWarning: the codebook explains many regions of a view badly.

    Example:
        >>> regions = scoup.load_regions("scene", scoup.load_cameras("scene"))
        >>> codes = scoup.code_regions(scoup.RegionEmbeddings.load(regions), scoup.BuildSettings(n_atoms=8))
        >>> codes.codebook.shape[:2]
        torch.Size([3, 8])
    """
    settings, device = build_settings(settings), torch.device(device)
    embeddings.check()
    if codebook is not None:
        return _coded_by(codebook, embeddings, settings.k, device)
    learned: list[tuple[Tensor, SparseCodes, dict[str, Any]]] = []
    for level, rows in zip(embeddings.levels, embeddings.of_levels, strict=True):
        stage = f"coding {level}"
        book = fit_codes(
            rows.to(device),
            **settings.of_fit,
            progress=lambda _, done, total, stage=stage: progress(stage, done, total),
        )
        learned.append((book.atoms.cpu(), book.codes.to("cpu"), _to_dict(book.report)))
    atoms, codes, reports = zip(*learned, strict=True)
    return RegionCodes(torch.stack(atoms), codes, embeddings.rows, reports)


def _coded_by(field: Field, embeddings: RegionEmbeddings, k: int, device: torch.device) -> RegionCodes:
    if embeddings.levels != field.levels:
        raise InputError(
            f"the regions have levels {list(embeddings.levels)}, the field of the codebook {list(field.levels)}; "
            "use regions made as that field's were"
        )
    codes, reports = [], []
    for level, rows, atoms, places in zip(
        embeddings.levels, embeddings.of_levels, field.codebook, embeddings.rows, strict=True
    ):
        if rows.shape[1] != field.dim:
            raise InputError(
                f"the regions have embeddings of {rows.shape[1]} dimensions, the field of the codebook {field.dim}; "
                "extract them with the model of that field"
            )
        rows, atoms = normalise_embeddings(rows.to(device)), atoms.to(device)
        threshold = field.info.provenance.get("coding", {}).get(level, {}).get("explained_from")
        known = isinstance(threshold, float)
        coded = encode_rows(rows, atoms, k, threshold if known else 0.0)
        report = report_on(rows, atoms, coded.codes, CODEBOOK_OF_FIELD)
        if known:
            report = replace(report, explained_from=threshold)
            _warn_of_badly_explained(coded.badly_explained.cpu(), places)
        codes.append(coded.codes.to("cpu"))
        reports.append(_to_dict(report))
    return RegionCodes(field.codebook.cpu(), codes, embeddings.rows, reports)


def _warn_of_badly_explained(badly: Tensor, places: Mapping[str, slice]) -> None:
    names = [
        name for name, rows in places.items() if len(badly[rows]) and float(badly[rows].float().mean()) > MANY
    ]
    if names:
        warnings.warn(
            f"the codebook explains more than {MANY:.0%} of the regions of {listed(names, 5)} badly; to learn a new "
            "one, build without `codebook`",
            ScoupWarning,
            stacklevel=5,
        )


def _to_dict(report: CodingReport) -> dict[str, Any]:
    """Return a report without its seconds, with which two equal builds would write different bytes."""
    return {name: value for name, value in asdict(report).items() if name != "seconds"}


def inputs_digest(
    fingerprint: str,
    cameras: Cameras,
    embeddings: RegionEmbeddings,
    settings: BuildSettings,
    codebook: Field | None = None,
) -> str:
    """Return a SHA-256 of everything a result depends on but label maps, which have a digest per view.

    ``fingerprint`` is that of the Gaussians, ``codebook`` the earlier field whose codebook is used.
    """
    decisive = settings.to_dict()
    if codebook is not None:
        atoms = codebook.codebook.cpu().contiguous().numpy()
        decisive["codebook"] = hashlib.sha256(atoms.data).hexdigest()
    digest = hashlib.sha256(json.dumps([VERSION, fingerprint, decisive], sort_keys=True).encode())
    for camera in cameras:
        digest.update(json.dumps([camera.name, camera.fingerprint()]).encode())
    for level, of_level, rows in zip(embeddings.levels, embeddings.of_levels, embeddings.rows, strict=True):
        ends = {name: span.stop for name, span in rows.items()}
        digest.update(json.dumps([level, list(of_level.shape), ends]).encode())
        digest.update(of_level.contiguous().numpy().data)
    return digest.hexdigest()
