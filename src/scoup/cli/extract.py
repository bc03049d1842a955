"""scoup extract: photographs to region maps and embeddings."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from scoup.base import InputError, Part, counted
from scoup.cli.console import Console, command, kept
from scoup.cli.options import CLIP_MODEL, AllCommon, PhotographMasks, arg

if TYPE_CHECKING:
    from scoup.base import Part, Progress
    from scoup.extract import ExtractReport, Photograph, PhotographChoice
    from scoup.models import ConceptModel


@dataclass(frozen=True, kw_only=True)
class PhotographOptions:
    """Choice of photographs."""

    views: str | None = None
    """How many photographs to extract: a number, more beside those chosen before (+40), or all. Default: up to 24 all;
    of more, those that show the scene sharply and from new directions, by renders of its splat or COLMAP's points."""
    gaussians: Path | None = None
    """The trained splat by which photographs are chosen. Default: the one in SCENE."""
    images: Path | None = None
    """Folder of the photographs. Default: images, images_2, images_4 or images_8 in SCENE."""


@dataclass(frozen=True, kw_only=True)
class ModelOptions:
    """The models."""

    segmenter: str | None = None
    """A segmenter of --list, such as sam2.1-tiny; a folder or hub id of a SAM; or felzenszwalb: regions of even colour,
    no model. Default: sam-vit-h on a GPU, as LangSplat; mobile-sam without one."""
    embedder: str = CLIP_MODEL
    """An embedder of --list; any CLIP, SigLIP or TIPSv2 by folder or hub id, with dense: before it for one pass over
    the photograph instead of one for each region; or colors: no model; cannot be queried by text."""
    list_models: Annotated[bool, arg(name="list")] = False
    """Print a table of segmenters, embedders and models with words, and whether their weights are on this machine; do
    nothing else."""


@dataclass(frozen=True, kw_only=True)
class ConceptOptions:
    """Words to detect."""

    concepts: str | None = None
    """Also look for words in the photographs, by which scoup build names things: a file with one word per line, or
    everyday, for about a thousand everyday words."""
    concept_model: str = "owlv2"
    """The model for --concepts, of --list."""


@dataclass(frozen=True, kw_only=True)
class MaskOptions:
    """Options of the masks."""

    preset: Annotated[Literal["langsplat", "fast"] | None, arg()] = None
    """langsplat: its rules to the letter. fast: one grid of points instead of five, no points in masks found before,
    early filters, 16 bits where the device can. Default: langsplat on a GPU, fast without one."""
    points_per_side: int | None = None
    """Points along each side of a grid. Default: 32."""


@dataclass(frozen=True, kw_only=True)
class Extract:
    """Cut the photographs of a scene into regions at three levels, and give each region an embedding.

    To resume after an interruption, run the same command again; changed photographs are processed again. Models are
    fetched on first use into the cache of Hugging Face; --segmenter felzenszwalb --embedder colors needs none.
    """

    scene: Annotated[tyro.conf.Positional[Path | None], arg(metavar="SCENE")] = None
    """Folder with cameras and photographs, or of photographs alone."""
    out: Path | None = None
    """Folder for the regions. Default: SCENE/language_features, where scoup build looks."""
    part: str | None = None
    """I/N, such as 1/4: extract only every N-th photograph from the I-th on. Parts may be made in any order, on any
    machine that sees the folder."""
    show: Annotated[str | None, arg(metavar="VIEW")] = None
    """Extract nothing: draw the regions of this view, which --out contains, beside its photograph, as VIEW_regions.png
    here."""
    photographs: Annotated[PhotographOptions, arg(name="photograph")] = PhotographOptions()
    hidden: Annotated[PhotographMasks, arg(name="photograph mask")] = PhotographMasks()
    models: Annotated[ModelOptions, arg(name="model")] = ModelOptions()
    words: ConceptOptions = ConceptOptions()
    masks: Annotated[MaskOptions, arg(name="mask")] = MaskOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        if self.models.list_models:
            _list_models(console)
        elif self.show is not None:
            self._draw(console, self.show)
        else:
            console.result(self.make(console))

    def make(self, console: Console, dimensions: Mapping[str, int] | None = None) -> dict[str, Any]:
        """Extract and report; returns what the result says. Embeddings must have the ``dimensions`` of these files."""
        from scoup.cli.views import is_splat
        from scoup.extract import (
            PhotographChoice,
            crops_minutes,
            extract,
            find_photographs,
            mask_settings,
            open_pair,
            report_masks,
        )
        from scoup.io import ScenePaths, load_gaussians
        from scoup.models import open_concepts
        from scoup.uplift import fitting_scene

        scene = self._scene()
        if is_splat(scene):
            remedy = f"{command('build', scene)} makes views of it first"
            raise InputError(f"{scene}: is a splat, expected photographs; {remedy}")
        scene = fitting_scene(scene, self.photographs.gaussians, self.photographs.images)
        words = self._words()  # a mistake shows before the long work
        segmenter_name, preset = self._masks(console, self.common.device)
        settings = mask_settings(preset, points_per_side=self.masks.points_per_side)
        wanted = self.photographs
        photographs = find_photographs(scene, wanted.images, self.hidden.keep)
        if masked := report_masks(photographs, scene, wanted.gaussians, wanted.images):
            console.say(f"{masked}; --no-masks ignores them")
        part = Part() if self.part is None else Part.parse(self.part)
        out = ScenePaths(scene).features(self.out, to_make=True)
        overwrite, is_part = self.common.overwrite, self.part is not None
        choice = PhotographChoice.of(scene, photographs, wanted.views, out, overwrite, is_part)
        if wanted.gaussians is not None:
            splat = ScenePaths(scene).splat(wanted.gaussians)  # mistakes show before the long work
            if choice is None:
                load_gaussians(splat.path)  # the choice reads it otherwise
        concepts = open_concepts(self.words.concept_model, device=self.common.device) if words else None
        started = time.perf_counter()
        segmenter, embedder = open_pair(
            segmenter_name, self.models.embedder, settings, self.common.device, None if overwrite else out
        )
        for name, size in (dimensions or {}).items():
            if size != embedder.dim:
                raise InputError(
                    f"{name}: contains vectors of {size} dimensions, but the embedder makes embeddings of "
                    f"{embedder.dim}; use the one made with the same model"
                )
        views = None if choice is None else self._choose(console, choice)
        chosen = views or photographs
        is_dense_too = not embedder.name.startswith("open_clip:")
        if is_dense_too and (minutes := crops_minutes(embedder, len(part.of(chosen)))) > 5:
            console.say(
                f"one crop per region will take about {minutes:.0f} minutes; --embedder dense:{embedder.name} makes "
                "one pass per photograph, with somewhat other answers (docs/extract.md)"
            )
        with _extracting(console, out, part) as progress:
            report = extract(chosen, out, segmenter, embedder, overwrite, part, progress, views is not None)
        seconds = time.perf_counter() - started
        _say(console, report, out, seconds, part)
        parts = {} if self.part is None else {"part": part.number, "of_parts": part.count}
        record = {**_record(report), "seconds": round(seconds, 2), "embedding_model": embedder.name, **parts}
        if concepts is not None:
            record["concepts"] = self._look_for_words(console, concepts, chosen, words, out, part)
        return {"out": out, "photographs": len(photographs), "chosen": len(chosen), **record}

    def _scene(self) -> Path:
        if self.scene is None:
            raise InputError("pass the folder of the scene, or --list")
        return self.scene

    def _draw(self, console: Console, view: str) -> None:
        """Draw the regions of a view at all levels, with their numbers where there is room."""
        from scoup.base import check_output
        from scoup.io import RegionStore, ScenePaths, load_cameras, load_image, load_regions, save_png
        from scoup.pictures import regions_sheet

        scene = self._scene()
        camera = load_cameras(scene, self.photographs.images, distorted="undistort", missing_images="keep")[
            view
        ]
        picture = Path(f"{camera.stem}_regions.png")
        check_output(picture, overwrite=self.common.overwrite)
        folder = self.out or ScenePaths(scene).folder
        regions = load_regions(folder, [camera])
        manifest = RegionStore.open(folder).manifest
        settings = manifest.settings if manifest else {}
        made = " and ".join(str(settings[key]) for key in ("segmenter", "embedder") if key in settings)
        labels, embeddings = regions.load_view(camera.name, camera.width, camera.height)
        remark = f"made with {made}" if made else ""
        sheet = regions_sheet(load_image(camera), labels, regions.levels, camera.name, remark)
        save_png(sheet, picture, self.common.overwrite)
        counts = {level: len(rows) for level, rows in zip(regions.levels, embeddings, strict=True)}
        shares = ((plane >= 0).float().mean() for plane in labels)
        covered = {level: round(float(share), 4) for level, share in zip(counts, shares, strict=True)}
        listed = [
            f"{level}: {counted(counts[level], 'region')}, {covered[level]:.0%} covered" for level in counts
        ]
        console.say(f"{picture}: {camera.name} ({', '.join(listed)})")
        console.result({"out": picture, "view": camera.name, "regions": counts, "covered": covered})

    def _choose(self, console: Console, choice: PhotographChoice) -> list[Photograph] | None:
        """Return the photographs to extract; None for all, if they cannot be compared and no number is passed."""
        wanted, count = self.photographs, len(choice.photographs)
        try:
            with console.progress() as progress:
                chosen = choice.choose(wanted.gaussians, wanted.images, progress)
        except InputError as error:
            if wanted.views is not None:
                raise
            console.say(f"takes all {count:,} photographs, for they cannot be compared: {error}")
            return None
        console.say(f"{len(chosen):,} of {counted(count, 'photograph')}; --views all takes all")
        return chosen

    def _words(self) -> tuple[str, ...]:
        from scoup.io import read_words
        from scoup.models import EVERYDAY_WORDS

        if self.words.concepts is None:
            return ()
        return EVERYDAY_WORDS if self.words.concepts == "everyday" else read_words(Path(self.words.concepts))

    def _look_for_words(
        self,
        console: Console,
        model: ConceptModel,
        photographs: Sequence[Photograph],
        words: Sequence[str],
        out: Path,
        part: Part,
    ) -> dict[str, Any]:
        """Store detections of words in the photographs; return their entry in the result."""
        from scoup.extract import extract_concepts
        from scoup.io import DetectionStore

        folder = out / DetectionStore.FOLDER
        with console.progress() as progress:
            report = extract_concepts(
                photographs, folder, model, words, self.common.overwrite, part, progress
            )
        seconds = sum(report.seconds.values())
        console.say(
            f"{folder}: {counted(len(words), 'word')} looked for in {counted(len(report.made), 'photograph')}, "
            f"{report.kept:,} already there, in {seconds:.0f} s"
        )
        return {"words": len(words), **_record(report)}

    def _masks(self, console: Console, device: str) -> tuple[str, Literal["langsplat", "fast"]]:
        """Segmenter and preset, which are printed: LangSplat's on a GPU, the fastest that are good without one."""
        on_gpu = device.startswith("cuda")
        segmenter = self.models.segmenter or ("sam-vit-h" if on_gpu else "mobile-sam")
        preset = self.masks.preset or ("langsplat" if on_gpu else "fast")
        console.say(f"segmenter {segmenter}, preset {preset}, embedder {self.models.embedder}")
        return segmenter, preset


def _list_models(console: Console) -> None:
    from scoup.extract import model_tables

    rows = model_tables()
    for records in rows.values():
        lines = [list(records[0]), *(list(record.values()) for record in records)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        for line in lines:
            cells = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
            console.say("  ".join(cells).rstrip())
        console.say("")
    console.result(rows)


@contextmanager
def _extracting(console: Console, out: Path, part: Part) -> Iterator[Progress]:
    """Yield a progress callback that also reports resumed and interrupted work; ``out`` is locked."""
    started, before = False, console.kept()

    def report(stage: str, done: int, total: int) -> None:
        nonlocal started
        if not started and 0 < done < total:
            console.say(f"{out}: resumes: {done} of {total} views are done")
        started = True
        console.kept = lambda: kept(f"{done} of {total} views") if done else before
        progress(stage, done, total)

    with part.reserved(out), console.progress() as progress:
        yield report


def _record(report: ExtractReport) -> dict[str, Any]:
    return {
        "made": len(report.made),
        "kept": report.kept,
        "skipped": report.skipped,
        "regions": report.regions,
        "bytes": report.bytes,
        "stages": {stage: round(value, 2) for stage, value in report.seconds.items()},
    }


def _say(console: Console, report: ExtractReport, out: Path, seconds: float, part: Part) -> None:
    made = len(report.made)
    there = f", {report.kept:,} already there" if report.kept else ""
    of = "" if part.count == 1 else f" (part {part.number} of {part.count})"
    console.say(f"{out}: {counted(made, 'view')} made{there}{of}, in {seconds:.0f} s")
    if made:
        stages = ", ".join(f"{stage} {value / made:.2f}" for stage, value in report.seconds.items())
        console.say(
            f"{report.regions / made:.0f} regions and {report.bytes / made / 1e3:.0f} kB a view; "
            f"seconds a view: {stages}"
        )
