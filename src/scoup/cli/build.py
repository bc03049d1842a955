"""scoup build: from a splat, cameras and photographs, or regions of them, to a language field."""

from __future__ import annotations

import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from scoup.base import InputError, Part, ScoupWarning, check_output, counted, reserved_output
from scoup.cli.build_options import (
    BuildOptions,
    CodingOptions,
    SceneOptions,
    SumOptions,
    check_field_output,
    passed_options,
    report_field,
    with_frame_of,
)
from scoup.cli.console import Console, command, detector_command, kept
from scoup.cli.options import CLIP_MODEL, AllCommon, PhotographMasks, arg

if TYPE_CHECKING:
    from scoup.field import Field
    from scoup.scene import Cameras, Detections, Gaussians, Regions
    from scoup.uplift import BuildSettings, RegionSums

CLIP_DIM = 512
LEAST_BYTES = 10  # of a field, per Gaussian


@dataclass(frozen=True, eq=False)
class _Loaded:
    """The inputs of a build."""

    gaussians: Gaussians
    cameras: Cameras
    regions: Regions
    source: Path
    settings: BuildSettings
    model: str
    words: Path | None
    concepts: tuple[Sequence[str], Mapping[str, Detections]] | None


@dataclass(frozen=True, kw_only=True)
class Build:
    """Build a language field from a trained splat, its cameras, and photographs.

    SCENE is an output folder of COLMAP, nerfstudio or Inria's code. Photographs without regions are cut into regions
    first, as scoup extract does; that takes most of the time, and resumes. For a splat alone, name it instead: views of
    it are rendered and cut into regions, in <out>_views.
    """

    scene: Annotated[tyro.conf.Positional[Path], arg(metavar="SCENE")]
    """Folder with cameras (and usually the photographs), or a cameras file; or a splat alone."""
    out: Path | None = None
    """The field to write, a .scoup file. Default: <name of SCENE>.scoup here."""
    parts: Annotated[SceneOptions, arg(name="scene")] = SceneOptions()
    hidden: Annotated[PhotographMasks, arg(name="photograph mask")] = PhotographMasks()
    method: Annotated[BuildOptions, arg(name="field")] = BuildOptions()
    coding: CodingOptions = CodingOptions()
    region_sums: Annotated[SumOptions, arg(name="region sum")] = SumOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.cli.views import is_splat
        from scoup.field import doubt_of
        from scoup.uplift import fitting_scene

        if is_splat(self.scene):
            return self._of_splat(console).run(console)
        model = fitting_scene(self.scene, self.parts.gaussians, self.parts.images)
        if model != self.scene:
            return replace(self, scene=model).run(console)
        if self.region_sums.sums is not None and self.region_sums.keep_sums is not None:
            raise InputError(
                "pass --sums to build from region sums, or --keep-sums to add what they lack, not both"
            )
        if self.region_sums.part is not None:
            return self._write_part(console)
        out = self._out()
        check_field_output(out, self.common.overwrite)
        begun = time.perf_counter()
        extracted = self._extract(console)
        loaded = self._load(console)
        started = time.perf_counter()
        with reserved_output(out, self.common.overwrite) as work:
            sums = self._open_sums(loaded, self.region_sums.keep_sums or work / "sums")
            field = with_frame_of(out, self._build(console, loaded, sums))
            field.save(out, self.common.overwrite, self.method.embed_geometry)
        if not (field.embedding_model or field.info.words):
            remedy = "build with --model, or pass --text to each question"
            warnings.warn(f"{out}: names nothing that can encode texts; {remedy}", ScoupWarning, stacklevel=2)
        kept_sums, seconds = sums if self.region_sums.keep_sums else None, time.perf_counter() - started
        report_field(console, field, out, kept_sums, self.common.device, seconds, extracted)
        whole = f"{time.perf_counter() - begun:.0f} s in all; " if extracted else ""
        doubt = ""
        if field.thing_table is not None:
            things = field.thing_table.to("cpu")
            if doubt := doubt_of(things.owners.numpy(), things.levels.numpy()):
                console.say(f"{doubt} (docs/answers.md#where-a-field-is-unsure)")
        console.say(whole + _suggestion(field, out, bool(doubt)))
        return None

    def _out(self) -> Path:
        from scoup.io import ScenePaths

        return self.out or Path(f"{ScenePaths(self.scene).folder.resolve().name}.scoup")

    def _extract(self, console: Console) -> dict[str, Any]:
        """Cut the photographs into regions unless that is done; returns what the result says of it."""
        from scoup.cli.extract import Extract, ModelOptions, PhotographOptions
        from scoup.extract import lacks_views
        from scoup.io import ScenePaths

        named = [*passed_options(self.hidden)]
        named += [name for name in passed_options(self.method) if name in ("--segmenter", "--embedder")]
        for option, given in (("--features", self.parts.features), ("--sums", self.region_sums.sums)):
            if given is not None and named:
                raise InputError(
                    f"{' and '.join(named)} would make regions, but {option} names some; pass either"
                )
            if given is not None:
                return {}
        paths, embedder = ScenePaths(self.scene), self.method.embedder or CLIP_MODEL
        made = paths.features(to_make=True)
        if not named and made.is_dir() and not lacks_views(made, self.scene, self.parts.images, embedder):
            return {}
        dimensions = self.check()
        return Extract(
            scene=self.scene,
            photographs=PhotographOptions(gaussians=self.parts.gaussians, images=self.parts.images),
            hidden=self.hidden,
            models=ModelOptions(segmenter=self.method.segmenter, embedder=embedder),
            common=AllCommon(device=self.common.device),
        ).make(console, dimensions)

    def check(self) -> dict[str, int]:
        """Look at all that a build needs but regions, before the photographs are cut into them: that may take hours.

        Returns:
            The dimensions that embeddings must have, by the file that needs them.
        """
        from scoup.field import Field
        from scoup.io import ScenePaths, load_gaussians
        from scoup.models import WordTable, check_model
        from scoup.scene import Cameras
        from scoup.uplift import check_scene

        dimensions = {}
        if (model := self.method.model) is not None:
            if WordTable.is_meant(model):
                dimensions[model] = WordTable.load(model).vectors.shape[1]
            else:
                check_model(model)
        if (codebook := self.coding.codebook) is not None:
            dimensions[str(codebook)] = Field.load(codebook).dim
        splat = ScenePaths(self.scene).splat(self.parts.gaussians)
        settings = self._settings(splat.preset)
        gaussians = load_gaussians(splat.path).to(self.common.device)
        kept_sums = self.region_sums.keep_sums
        outputs = [self._out(), *([] if kept_sums is None else [kept_sums / "sums"])]
        check_output(*outputs, overwrite=True, least=LEAST_BYTES * len(gaussians))
        cameras = self.parts.load_cameras(self.scene)
        shown = Cameras(camera for camera in cameras if camera.image_path)
        check_scene(gaussians, shown if len(shown) else cameras, settings, splat.path)
        return dimensions

    def _build(self, console: Console, loaded: _Loaded, sums: RegionSums) -> Field:
        """Build with progress; what an interruption leaves is reported."""
        from scoup.field import Field
        from scoup.uplift import FieldSources, build, name_field

        self._report_resumed(console, sums, len(loaded.regions))
        codebook = None if self.coding.codebook is None else Field.load(self.coding.codebook)
        try:
            with console.progress() as progress:
                field = build(
                    loaded.gaussians, loaded.cameras, loaded.regions, loaded.settings,
                    sources=FieldSources(loaded.model, loaded.words, loaded.source), sums=sums, codebook=codebook,
                    progress=progress,
                )  # fmt: skip
            if loaded.concepts is None:
                return field
            texts, found = loaded.concepts
            views = [(view, found[view.name]) for view in field.cameras or () if view.name in found]
            return name_field(field, texts, views)
        finally:
            if self.region_sums.keep_sums is not None:
                sums.flush()

    def _of_splat(self, console: Console) -> Build:
        """Make views of a splat alone; returns the build of this scene."""
        from scoup.cli.views import make_views

        if self.region_sums.part is not None:
            raise InputError(f"{self.scene}: make its scene first, with scoup views and scoup extract")
        if self.parts.gaussians is not None:
            raise InputError(f"{self.scene}: is a splat; pass the scene, and the splat with --gaussians")
        out = self.out or Path(f"{self.scene.stem}.scoup")
        check_field_output(out, self.common.overwrite)
        folder = out.with_name(f"{out.stem}_views")
        make_views(console, self.scene, folder, self.common.overwrite)
        # Named, so that an extraction that was interrupted is resumed.
        parts = replace(self.parts, gaussians=self.scene)
        method = replace(self.method, embedder=self.method.embedder or CLIP_MODEL)
        return replace(self, scene=folder, out=out, parts=parts, method=method)

    def _write_part(self, console: Console) -> None:
        """Rasterise a part of the views, keep their region sums and report."""
        from scoup.scene import Cameras
        from scoup.uplift import cameras_with_regions, check_scene, region_sums

        part, folder = Part.parse(self.region_sums.part or ""), self.region_sums.keep_sums
        if folder is None:
            raise InputError("--part needs the folder for the region sums: pass --keep-sums")
        groups = (self.hidden, self.method, self.coding)
        later = [
            *(name for group in groups for name in passed_options(group)),
            *(["--out"] if self.out else []),
        ]
        if later:
            raise InputError(f"--part writes region sums only; pass {', '.join(later)} to scoup build --sums")
        loaded = self._load(console)
        started = time.perf_counter()
        views = cameras_with_regions(loaded.cameras, loaded.regions)
        chosen, settings = Cameras(part.of(views)), loaded.settings
        with part.reserved(folder):
            sums = self._open_sums(loaded, folder)
            check_fit = bool(len(chosen)) and not len(sums)
            check_scene(loaded.gaussians, chosen, settings, loaded.source, check_fit)
            self._report_resumed(console, sums, len(views))
            with console.progress() as progress:
                region_sums(
                    loaded.gaussians, loaded.cameras, loaded.regions, settings, sums=sums, part=part, progress=progress
                )  # fmt: skip
            sums.flush()
        seconds = time.perf_counter() - started
        console.say(
            f"{folder}: part {part.number} of {part.count}, {counted(len(chosen), 'view')} of {len(views):,}, "
            f"in {seconds:.0f} s; with all parts there: {command('build', self.scene, '--sums', folder)}"
        )
        console.result(
            {"sums": folder, "views": len(chosen), "of_views": len(views), "seconds": round(seconds, 2)}
        )

    def _settings(self, raster_preset: str) -> BuildSettings:
        """Return the preset with the options passed; ``raster_preset`` is the splat's."""
        from scoup.uplift import build_settings

        changes = {"n_atoms": self.coding.n_atoms, "k": self.coding.k, "scale": self.region_sums.scale}
        preset = raster_preset if self.parts.raster_preset == "auto" else self.parts.raster_preset
        check_fit = not self.parts.no_check_fit
        return build_settings(self.method.preset, **changes, raster_preset=preset, check_fit=check_fit)

    def _load(self, console: Console) -> _Loaded:
        from scoup.io import DetectionStore, ScenePaths, load_gaussians, load_regions
        from scoup.uplift import embedding_source

        paths = ScenePaths(self.scene)
        splat = paths.splat(self.parts.gaussians)
        source = splat.path
        settings = self._settings(splat.preset)  # a mistake shows before the long work
        gaussians = load_gaussians(source).to(self.common.device)
        cameras, features = self.parts.load_cameras(self.scene), paths.features(self.parts.features)
        regions = load_regions(features, cameras)
        model, words = embedding_source(features, regions, self.method.model)
        if words is None:
            model = model or _usual_model(regions)
        console.say(
            f"{counted(len(gaussians), 'Gaussian')}, {counted(len(regions), 'view')} with regions of "
            f"{counted(len(cameras), 'camera')}"
        )
        store = DetectionStore.beside(features)
        concepts = None if store is None else (store.texts, store.of(regions.view_names))
        return _Loaded(gaussians, cameras, regions, source, settings, model, words, concepts)

    def _open_sums(self, loaded: _Loaded, folder: Path) -> RegionSums:
        """Return the sums that are named, or those to complete in the folder."""
        from scoup.uplift import RegionSums, cameras_with_regions, open_sums

        if self.region_sums.sums is not None:
            return RegionSums.open(self.region_sums.sums)
        views = cameras_with_regions(loaded.cameras, loaded.regions)
        return open_sums(folder, loaded.gaussians, loaded.regions, loaded.settings, views)

    def _report_resumed(self, console: Console, sums: RegionSums, views: int) -> None:
        """Report what is resumed, and what an interruption leaves."""
        if self.region_sums.keep_sums is None:
            return
        before = console.kept()

        def report_kept() -> str:
            stored = sums.stored_size()[0]
            return kept(f"{stored} of {views} views") if stored else before

        console.kept = report_kept
        if len(sums):
            console.say(f"{sums.path}: contains {counted(len(sums), 'view')} already")


def _suggestion(field: Field, out: Path, doubtful: bool) -> str:
    """Return the next command for a field: a query only if the field names a text encoder."""
    from scoup.models import words_problem

    model = field.embedding_model
    if field.info.words is None and (not model or words_problem(model)):
        return f"look at it: {command('view', out)}, or {command('render', out, '--what', 'codes')}"
    asked = detector_command(out, "WORD") if doubtful else command("query", out, "WORD")
    return f"ask it: {asked}, or {command('view', out)}"


def _usual_model(regions: Regions) -> str:
    """Return LangSplat's CLIP model for features that do not name theirs; "" where it cannot have made them."""
    rows = regions.load_embeddings(regions.view_names[0], regions.levels[0])
    return CLIP_MODEL if rows.shape[1] == CLIP_DIM else ""
