"""``build``: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup import __version__, raster
from scoup.cameras import Camera, Cameras
from scoup.checkpoint import BuildState, Checkpoint, Embeddings, build_key
from scoup.codes import SparseCodes
from scoup.coding import Codebook, fit_codes
from scoup.consensus import consensus
from scoup.errors import InputError, ScoupWarning, UnknownNameError
from scoup.field import FieldInfo, LanguageField
from scoup.gaussians import Gaussians
from scoup.lifting import Lift, Source
from scoup.processes import Processes, at_work
from scoup.progress import Progress, no_progress
from scoup.regions import Regions
from scoup.uplifting import RegionSums, cameras_with_regions, digest_of_labels, region_sums, top_k

MOST_OF_MEMORY = 0.5  # of a GPU's free memory, for accumulators
FEW_GAUSSIANS = 0.01  # share of coded Gaussians under which the frames of splat and cameras are doubted


@dataclass(frozen=True)
class BuildSettings:
    """Everything that decides what a build computes. ``BUILD_PRESETS`` names two: "default" (what answers best, and
    what ``BuildSettings()`` is) and "paper".

    Attributes:
        n_atoms: L, atoms in each level's codebook.
        k: K, atoms in the code of a region.
        keep: atoms kept for each Gaussian by the vote; None (default) keeps k, 0 keeps all (no top-K step).
        rounds: of the vote, 1 or more. One is the paper's; each further one lifts all views again and counts regions by
            their agreement with the outcome so far (``scoup.agreement``).
        consensus: give regions that the same Gaussians see similar embeddings before coding (``scoup.consensus``).
            The region sums of all views are then kept in memory.
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
    keep_accumulators: bool = False,
    backend: str | None = None,
    checkpoint: str | Path | None = None,
    sums: RegionSums | None = None,
    progress: Progress = no_progress,
) -> LanguageField:
    """Build a language field (method.md, stages 1 and 2): learn codes per level, lift them view by view, vote.

    The parts can be called one by one: ``fit_codes``, ``region_sums``, ``uplift``, ``top_k``, ``LanguageField``.
    Beyond the embeddings, and then the codes, of all regions, memory does not grow with the number of views.

    Where torch's process group is set up (torchrun), each process learns the codes of some levels and lifts its share
    of the views; all of them return the same field. Sums are then rounded in another order than by one process.

    Args:
        gaussians: the trained scene; never changed.
        cameras: posed views; those without regions are passed over.
        regions: region maps and embeddings.
        n_atoms, k: size of the codebook and of a code, where they are not those of ``settings``.
        settings: everything that decides the result, or the name of one of ``BUILD_PRESETS``.
        embedding_model: id of the model the embeddings come from, kept in the field.
        geometry_path: file of the Gaussians, kept in the field as a reference.
        keep_accumulators: keep the float sums, so that views can be added later (N x S x L x 4 bytes).
        backend: rasteriser backend by name.
        checkpoint: file where the codes, and now and then the sums, are kept while building; an interrupted build
            with the same inputs goes on from it. It stays, so that the codes are not lost if the field cannot be
            saved; delete it afterwards.
        sums: region sums of these very Gaussians, cameras and regions (``region_sums``), if they are at hand;
            nothing is rasterised then.
        progress: called as ``progress(stage, done, total)``.

    Raises:
        InputError: no camera has regions, the cameras see nothing, or the inputs do not fit.
    """
    settings = build_settings(settings, n_atoms=n_atoms, k=k)
    views = cameras_with_regions(cameras, regions)
    regions = regions.select(camera.name for camera in views)
    embeddings = {level: regions.embeddings(level) for level in regions.levels}
    _check_embeddings(embeddings)
    rows = [of_views for _, of_views in embeddings.values()]
    if sums is not None:
        _check_sums(sums, views, rows, len(gaussians), settings.raster_preset)
    fingerprint = gaussians.fingerprint()
    key = build_key(fingerprint, views, embeddings, dataclasses.asdict(settings))
    if settings.consensus and sums is None:
        chosen = Cameras(views)
        sums = region_sums(gaussians, chosen, regions, settings.raster_preset, backend, progress)

    scene = None if sums is not None else raster.prepare(gaussians, backend)
    # Region sums are kept on the CPU, and added there in a fixed order.
    device = gaussians.device if sums is None else torch.device("cpu")
    rows_order = "original" if scene is None or scene.order is None else "moved"
    keeper = Checkpoint(None if checkpoint is None else Path(checkpoint), key, rows_order)
    processes = at_work()
    state = keeper.read((len(gaussians), len(embeddings), settings.n_atoms))
    if None in processes.gather(None if state is None else len(state.views_done)):
        state = None  # one of the processes cannot go on from it
    if state is None:
        if settings.consensus and sums is not None:
            agreed = consensus(sums, [rows for rows, _ in embeddings.values()], progress=progress)
            embeddings = {
                level: (rows, of_views)
                for (level, (_, of_views)), rows in zip(embeddings.items(), agreed, strict=True)
            }
        state = _learn_codes(embeddings, settings, len(gaussians), device, processes, progress)
        if processes.first:
            keeper.write(state)
    else:
        state = state.to(device, _place_of_accumulators(device, state.accumulators.shape))
        _forget_other_maps(state, views, regions)
    del embeddings  # the uplift needs the codes only
    source = Source(views, regions, settings.raster_preset, scene, sums)
    lift = Lift(state, rows, len(views), keeper, progress, processes)
    while state.rounds_done + 1 < settings.rounds:
        lift.add_round(source)
        lift.end_round(source, settings.keep or settings.k)
    lift.add_round(source)
    accumulators = state.accumulators
    indices, weights = top_k(accumulators, settings.keep or None)
    if scene is not None:
        indices, weights = scene.restored(indices), scene.restored(weights)
        accumulators = scene.restored(accumulators) if keep_accumulators else accumulators
    try:
        _check_seen(weights)
    except InputError:
        keeper.remove()  # going on from it would end here again
        raise
    maps = hashlib.sha256(json.dumps(state.views_done, sort_keys=True).encode())
    provenance: dict[str, Any] = {
        "software": f"scoup {__version__}",
        "settings": dataclasses.asdict(settings),
        "inputs": key,
        "label_maps": maps.hexdigest(),
        "views": [camera.name for camera in views],
        "coding": dict(zip(regions.levels, state.reports, strict=True)),
    }
    if state.agreement is not None:
        provenance["sharpness"] = state.agreement.sharpness.tolist()
    info = FieldInfo(
        regions.levels, embedding_model, fingerprint, len(gaussians), settings.raster_preset, provenance
    )
    field = LanguageField(
        indices,
        weights,
        torch.stack(state.atoms),
        info,
        None,
        None if geometry_path is None else Path(geometry_path),
        accumulators if keep_accumulators else None,
        Cameras(views),
    ).to(gaussians.device)
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


def _check_embeddings(embeddings: dict[str, Embeddings]) -> None:
    dimensions = {level: rows.shape[1] for level, (rows, _) in embeddings.items()}
    if len(set(dimensions.values())) > 1:
        raise InputError(f"the levels have embeddings of different sizes {dimensions}: they mix models")
    for level, (rows, _) in embeddings.items():
        if not len(rows):
            raise InputError(f"level {level!r} has no regions in any view; every level needs some")
        if not rows.any():
            raise InputError(f"level {level!r} has only zero embeddings; make the region features again")


def _check_sums(
    sums: RegionSums, views: list[Camera], rows: list[dict[str, slice]], n_gaussians: int, raster_preset: str
) -> None:
    """Refuse region sums of another scene."""
    known = {view.view_name for view in sums.views}
    missing = sum(camera.name not in known for camera in views)
    same_rows = len(sums.rows) == len(rows) and all(
        kept.get(name) == part
        for kept, own in zip(sums.rows, rows, strict=True)
        for name, part in own.items()
    )
    if missing or not same_rows or sums.n_gaussians != n_gaussians or sums.raster_preset != raster_preset:
        raise InputError(
            f"the region sums given do not fit: {sums.n_gaussians} Gaussians (the scene has {n_gaussians}), preset "
            f"{sums.raster_preset} (wanted {raster_preset}), they lack {missing} of the views"
            f"{'' if same_rows else ', and their regions are others'}; make them with region_sums from the same "
            "Gaussians, cameras and regions"
        )


def _forget_other_maps(state: BuildState, views: list[Camera], regions: Regions) -> None:
    """Start the uplift over if label maps have changed since views were added to a checkpoint."""
    known = state.earlier_views | state.views_done
    for camera in views:
        if camera.name in known:
            labels, _ = regions.load_view(camera.name, camera.width, camera.height)
            if digest_of_labels(labels) != known[camera.name]:
                warnings.warn(
                    f"the label maps of {camera.name!r} have changed since the build was interrupted; "
                    "all views are lifted again",
                    ScoupWarning,
                    stacklevel=3,
                )
                state.start_over()
                return


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


def _learn_codes(
    embeddings: dict[str, Embeddings],
    settings: BuildSettings,
    n_gaussians: int,
    device: torch.device,
    processes: Processes,
    progress: Progress,
) -> BuildState:
    """Codes of every level, each learned by one of the processes, and empty accumulators."""
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
    atoms = [everything[level][0].to(device) for level in embeddings]
    codes = [everything[level][1].to(device) for level in embeddings]
    reports = [everything[level][2] for level in embeddings]
    shape = (n_gaussians, len(embeddings), settings.n_atoms)
    accumulators = torch.zeros(shape, device=_place_of_accumulators(device, shape))
    return BuildState(atoms, codes, reports, accumulators, {})


def _place_of_accumulators(device: torch.device, shape: Sequence[int]) -> torch.device:
    """Where the work is done, unless that is a GPU whose free memory they would fill."""
    if device.type != "cuda":
        return device
    free, _ = torch.cuda.mem_get_info(device)
    return device if 4 * math.prod(shape) <= MOST_OF_MEMORY * free else torch.device("cpu")


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
