"""``build``: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import torch
from torch import Tensor

from scoup.base.errors import InputError, ScoupWarning, UnknownNameError
from scoup.base.processes import Processes, at_work
from scoup.base.progress import Progress, no_progress
from scoup.base.version import VERSION
from scoup.coding import Codebook, fit_codes
from scoup.field.language_field import FieldInfo, LanguageField
from scoup.raster import morton_order
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.codes import SparseCodes
from scoup.scene.gaussians import Gaussians
from scoup.scene.regions import Regions
from scoup.uplift.consensus import consensus
from scoup.uplift.rasterise import cameras_with_regions, check_fits, exchanged, take_in
from scoup.uplift.region_codes import RegionCodes
from scoup.uplift.region_sums import RegionSums, camera_digest
from scoup.uplift.vote import vote

FEW_GAUSSIANS = 0.01  # share of coded Gaussians under which the frames of splat and cameras are doubted
_OF_CODES = (
    "n_atoms",
    "k",
    "solver",
    "effort",
    "epochs",
    "tolerance",
    "seed",
)  # settings that decide the codes


@dataclass(frozen=True)
class BuildSettings:
    """Everything that decides what a build computes. ``BUILD_PRESETS`` names two: "default" (what answers best, and
    what ``BuildSettings()`` is) and "paper".

    Attributes:
        n_atoms: L, atoms in each level's codebook.
        k: K, atoms in the code of a region.
        keep: atoms kept for each Gaussian by the vote; None (default) keeps k, 0 keeps all (no top-K step).
        rounds: of the vote, 1 or more. One is the paper's; in each further one regions count by their agreement with
            the outcome so far (``scoup.uplift.reweighting``).
        consensus: give regions that the same Gaussians see similar embeddings before coding
            (``scoup.uplift.consensus``).
        solver: how codes are learned, see ``fit_codes``.
        effort: of the "exact" solver, "fast" or "best".
        epochs: epochs of the "adam" solver.
        tolerance: stop the "adam" solver once its loss has fallen by less than this over 100 epochs; None never.
        seed: of the codebook's start.
        raster_preset: rasteriser constants the scene was trained with: "inria" or "gsplat".
    """

    n_atoms: int = 128
    k: int = 4
    keep: int | None = None
    rounds: int = 2
    consensus: bool = False
    solver: str = "exact"
    effort: str = "best"
    epochs: int = 4000
    tolerance: float | None = None
    seed: int = 0
    raster_preset: str = "inria"

    def __post_init__(self) -> None:
        if self.keep is None:
            object.__setattr__(self, "keep", self.k)
        keep = self.keep or 0
        if not 1 <= self.k <= self.n_atoms or not 0 <= keep <= self.n_atoms:
            raise InputError(
                f"k ({self.k}) and keep ({keep}) must not exceed the {self.n_atoms} atoms, and k must be at "
                "least 1"
            )
        if self.rounds < 1:
            raise InputError(f"the vote takes at least one round, not {self.rounds}")
        if self.tolerance is not None and not self.tolerance >= 0:
            raise InputError(f"the tolerance must be 0 or more, got {self.tolerance}")
        if not 0 <= self.seed < 1 << 63:
            raise InputError(f"the seed must be 0 to 2^63 - 1, got {self.seed}")


BUILD_PRESETS: dict[str, BuildSettings] = {
    "default": BuildSettings(),
    "paper": BuildSettings(n_atoms=64, rounds=1, solver="adam"),
}
"""What answers best at little cost (docs/benchmarks.md, "Codes and votes"), and the paper's method as published."""


def build(
    gaussians: Gaussians,
    cameras: Cameras,
    regions: Regions,
    n_atoms: int | None = None,
    k: int | None = None,
    settings: BuildSettings | str = "default",
    *,
    embedding_model: str = "",
    geometry_path: str | Path | None = None,
    backend: str | None = None,
    sums: RegionSums | None = None,
    progress: Progress = no_progress,
) -> LanguageField:
    """Build a language field (method.md, stages 1 and 2): learn codes per level, rasterise each view once, vote.

    The parts can be called one by one: ``fit_codes``, ``region_sums``, ``vote``, ``LanguageField``. Beyond the
    embeddings and codes of all regions, memory does not grow with the number of views.

    Where torch's process group is set up (torchrun), each process learns the codes of some levels, rasterises its share
    of the views and votes for its share of the Gaussians; all of them return the field that one process makes.

    Args:
        gaussians: the trained scene; never changed.
        cameras: posed views; those without regions are passed over.
        regions: region maps and embeddings.
        n_atoms, k: size of the codebook and of a code, where they are not those of ``settings``.
        settings: everything that decides the result, or the name of one of ``BUILD_PRESETS``.
        embedding_model: id of the model the embeddings come from, kept in the field.
        geometry_path: file of the Gaussians, kept in the field as a reference.
        backend: rasteriser backend by name; the vote takes the same.
        sums: region sums of these Gaussians, to go on from and to keep: views that are in them are not rasterised, the
            others are appended, and the codes are kept beside them. By default they are made and forgotten.
        progress: called as ``progress(stage, done, total)``.

    Raises:
        InputError: no camera has regions, the cameras see nothing, or the inputs do not fit.
    """
    settings = build_settings(settings, n_atoms=n_atoms, k=k)
    views = cameras_with_regions(cameras, regions)
    names = [camera.name for camera in views]
    regions = regions.select(names)
    embeddings = {level: regions.embeddings(level) for level in regions.levels}
    _check_embeddings(embeddings)
    fingerprint = gaussians.fingerprint()
    if sums is None:
        sums = RegionSums(fingerprint, morton_order(gaussians.means), regions.levels, settings.raster_preset)
    check_fits(sums, fingerprint, regions, settings.raster_preset)
    processes = at_work()
    device = gaussians.device

    if settings.consensus:  # each process needs all sums, before there are codes
        take_in(sums, gaussians, views, regions, backend, progress)
        embeddings = _agreed(sums, embeddings, progress)
    coded = _region_codes(sums, embeddings, settings, device, processes, progress)
    inputs = inputs_digest(fingerprint, views, embeddings, dataclasses.asdict(settings))
    del embeddings  # the vote needs the codes only
    if not settings.consensus:
        take_in(sums, gaussians, views, regions, backend, progress, processes)
        sums = exchanged(sums, names, processes)
    found = vote(
        sums, coded.codes, coded.codebook, settings.rounds, settings.keep or None, settings.keep or settings.k,
        coded.rows, backend, device, processes, progress,
    )  # fmt: skip
    _check_seen(found.weights)
    provenance: dict[str, Any] = {
        "software": f"scoup {VERSION}",
        "settings": dataclasses.asdict(settings),
        "inputs": inputs,
        "label_maps": labels_digest(sums, names),
        "views": names,
        "coding": dict(zip(regions.levels, coded.reports, strict=True)),
    }
    if found.sharpness is not None:
        provenance["sharpness"] = found.sharpness.tolist()
    if (sums.weights, sums.least_weight) != ("float32", 0):
        provenance["region_sums"] = {"weights": sums.weights, "least_weight": sums.least_weight}
    info = FieldInfo(
        regions.levels, embedding_model, fingerprint, len(gaussians), settings.raster_preset, provenance
    )
    field = LanguageField(
        found.indices,
        found.weights,
        coded.codebook,
        info,
        None,
        None if geometry_path is None else Path(geometry_path),
        Cameras(views),
    ).to(device)
    field.attach(gaussians, known=True)
    return field


def build_settings(settings: BuildSettings | str = "default", **changes: Any) -> BuildSettings:
    """Settings, or a preset by name, with some fields changed; None leaves a field as it is.

    Raises:
        UnknownNameError: there is no such preset.
        InputError: the settings do not go together.
    """
    if isinstance(settings, str):
        if settings not in BUILD_PRESETS:
            raise UnknownNameError("build preset", settings, BUILD_PRESETS)
        settings = BUILD_PRESETS[settings]
    changes = {name: value for name, value in changes.items() if value is not None}
    # Unless told otherwise, as many atoms stay as a code has.
    if "k" in changes and "keep" not in changes and settings.keep == settings.k:
        changes["keep"] = changes["k"]
    return dataclasses.replace(settings, **changes)


Embeddings: TypeAlias = "tuple[Tensor, dict[str, slice]]"
"""All embeddings of a level [R, D], and the rows of each view in them."""


def _check_embeddings(embeddings: dict[str, Embeddings]) -> None:
    dimensions = {level: rows.shape[1] for level, (rows, _) in embeddings.items()}
    if len(set(dimensions.values())) > 1:
        raise InputError(f"the levels have embeddings of different sizes {dimensions}: they mix models")
    for level, (rows, _) in embeddings.items():
        if not len(rows):
            raise InputError(f"level {level!r} has no regions in any view; every level needs some")
        if not rows.any():
            raise InputError(f"level {level!r} has only zero embeddings; make the region features again")


def _agreed(sums: RegionSums, embeddings: dict[str, Embeddings], progress: Progress) -> dict[str, Embeddings]:
    """The embeddings after consensus."""
    rows = [of_views for _, of_views in embeddings.values()]
    agreed = consensus(sums, [of_level for of_level, _ in embeddings.values()], rows, progress=progress)
    return dict(zip(embeddings, zip(agreed, rows, strict=True), strict=True))


def learn_codebook(rows: Tensor, settings: BuildSettings, progress: Progress = no_progress) -> Codebook:
    """Codebook and codes of the embeddings [R, D] of one level, by the settings of a build; see ``fit_codes``."""
    return fit_codes(
        rows,
        settings.n_atoms,
        settings.k,
        solver=settings.solver,
        effort=settings.effort,
        seed=settings.seed,
        epochs=settings.epochs,
        tolerance=settings.tolerance,
        progress=progress,
    )


def _region_codes(
    sums: RegionSums,
    embeddings: dict[str, Embeddings],
    settings: BuildSettings,
    device: torch.device,
    processes: Processes,
    progress: Progress,
) -> RegionCodes:
    """Codes of every level, each learned by one of the processes; kept beside the sums as soon as they are known."""
    solver = {name: getattr(settings, name) for name in _OF_CODES}
    key = inputs_digest("", [], embeddings, solver)
    kept = processes.gather(RegionCodes.kept(sums, key) if processes.first else None)[0]
    if kept is not None:
        return kept
    learned: dict[str, tuple[Tensor, SparseCodes, dict[str, Any]]] = {}
    for level in processes.share(list(embeddings)):
        rows, _ = embeddings[level]
        name = f"coding {level}"
        book = learn_codebook(
            rows.to(device), settings, lambda _, done, total, name=name: progress(name, done, total)
        )
        # Seconds would make two equal builds write different bytes.
        report = {key: value for key, value in dataclasses.asdict(book.report).items() if key != "seconds"}
        learned[level] = book.atoms.cpu(), book.codes.to("cpu"), report
    everything = {level: found for part in processes.gather(learned) for level, found in part.items()}
    found = [everything[level] for level in embeddings]
    coded = RegionCodes(
        torch.stack([atoms for atoms, _, _ in found]),
        [codes for _, codes, _ in found],
        [of_views for _, of_views in embeddings.values()],
        [report for _, _, report in found],
    )
    if processes.first and sums.writable:
        coded.keep(sums, key)
    return coded


def inputs_digest(
    fingerprint: str, cameras: Sequence[Camera], embeddings: dict[str, Embeddings], settings: dict[str, Any]
) -> str:
    """SHA-256 over everything a result depends on but the label maps, which are told apart view by view.

    Args:
        fingerprint: of the Gaussians.
        cameras: the views.
        embeddings: per level, as from ``Regions.embeddings``.
        settings: plain JSON values.
    """
    digest = hashlib.sha256(json.dumps([VERSION, fingerprint, settings], sort_keys=True).encode())
    for camera in cameras:
        digest.update(json.dumps([camera.name, camera_digest(camera)]).encode())
    for level, (rows, of_views) in embeddings.items():
        ends = {name: of_view.stop for name, of_view in of_views.items()}
        digest.update(json.dumps([level, list(rows.shape), ends]).encode())
        digest.update(rows.contiguous().numpy().data)
    return digest.hexdigest()


def labels_digest(sums: RegionSums, view_names: Sequence[str]) -> str:
    """SHA-256 of the label maps of views."""
    digests = {name: sums.views[name].labels_digest for name in view_names}
    return hashlib.sha256(json.dumps(digests, sort_keys=True).encode()).hexdigest()


def _check_seen(weights: Tensor) -> None:
    """Refuse codes [N, S, K] of a scene that the cameras do not see."""
    share = float((weights[..., 0] > 0).any(1).float().mean()) if len(weights) else 0.0
    advice = "check that splat and cameras are in the same frame (trainers often normalise the world)"
    if share == 0:
        raise InputError(f"the cameras see nothing: no Gaussian paints a region in any view; {advice}")
    if share < FEW_GAUSSIANS:
        warnings.warn(
            f"only {share:.2%} of the Gaussians paint a region; {advice}", ScoupWarning, stacklevel=3
        )
