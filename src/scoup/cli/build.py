"""scoup build: from a splat, cameras and regions to a language field."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from scoup.base.counts import counted
from scoup.cli.build_options import BuildOptions, check_field_name, check_field_output, report_field
from scoup.cli.console import Console, kept
from scoup.cli.options import CLIP_MODEL, Flag, OptionalPath, OptionalText, OptionGroups
from scoup.cli.scene_options import ViewOptions

if TYPE_CHECKING:
    from scoup.base.locks import Output
    from scoup.base.shares import Share
    from scoup.scene.cameras import Cameras
    from scoup.scene.gaussians import Gaussians
    from scoup.scene.regions import Regions
    from scoup.uplift.region_sums import RegionSums
    from scoup.uplift.shards import Shard

CLIP_DIM = 512


@dataclass(frozen=True, eq=False)
class _Loaded:
    """The inputs of a build."""

    gaussians: Gaussians
    cameras: Cameras
    regions: Regions
    source: Path
    raster_preset: str
    model: str
    words: Path | None


@dataclass(frozen=True, kw_only=True)
class Build(BuildOptions, ViewOptions):
    """Build a language field from a trained splat, its cameras, and region features.

    SCENE is an output folder of COLMAP, nerfstudio or Inria's code. For a splat alone, name it instead: views of it are
    rendered and cut into regions first, in <out>_views. To resume an interrupted build, run the same command again.
    """

    option_groups: ClassVar[OptionGroups] = {
        "scene": "gaussians raster_preset",
        "splat without a scene": "segmenter embedder",
        "region sum": "keep_sums sums sums_weights least_weight shard",
        "output": "out",
    }

    scene: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SCENE", help_behavior_hint="")]
    """Folder with cameras (and usually the photographs), or a cameras file; or a splat alone."""
    gaussians: OptionalPath = None
    """The trained splat: .ply, .splat, .spz, .glb and more, or a gsplat checkpoint. Default: the one in SCENE."""
    out: OptionalPath = None
    """The field to write, a .scoup file. Default: <name of SCENE>.scoup here."""
    model: OptionalText = None
    """Model of the region embeddings, which queries use too, or a word table made with it, which queries then use.
    Default: the model that the features name, else, for embeddings of 512 dimensions,
    laion/CLIP-ViT-B-16-laion2B-s34B-b88K."""
    raster_preset: Literal["auto", "inria", "gsplat"] = "auto"
    """Rasteriser constants the splat was trained with; auto: gsplat for its checkpoints, else inria."""
    segmenter: OptionalText = None
    """Segmenter for views of a splat alone, as for scoup extract."""
    embedder: OptionalText = None
    """Embedder for views of a splat alone, as for scoup extract."""
    keep_sums: Flag = False
    """Also write the region sums to <out>.sums: scoup update needs them, and --sums builds from them (other embeddings,
    codes or rounds) without rasterising."""
    sums: OptionalPath = None
    """Build from the region sums in this folder, written by --keep-sums, without rasterising."""
    sums_weights: Literal["float32", "float16"] = "float32"
    """Type of stored region sums: float16 takes 5 bytes per entry instead of 7."""
    least_weight: float = 0.0
    """Omit entries of the region sums below this, for less space. 0.01 omits a quarter to a half; Gaussians that
    contribute hardly anything lose their codes."""

    shard: OptionalText = None
    """I/N, such as 1/4: rasterise only this share of the views and write <out>.I-of-N.sums, in any order, on any
    machine. scoup merge makes the field of all shards, with the options of coding, vote and output."""

    def run(self, console: Console) -> None:
        """Build, save and report."""
        from scoup.base.locks import locked_output
        from scoup.base.shares import Share, device_of_process
        from scoup.uplift.build import build
        from scoup.uplift.checkpoint import save_field

        if (scene := self._of_splat(console)) is not None:
            return scene.run(console)
        share, device = Share.of_environment(), device_of_process(self.device)
        out = self._output(share)
        loaded = self._load(console, device)
        if self.shard is not None:
            return self._write_shard(console, out, loaded)
        if not share.is_everything:
            return self._build_together(console, out, loaded, share, device)
        started = time.perf_counter()
        with locked_output(out, self.overwrite) as output, self._region_sums(out, loaded) as sums:
            self._announce(console, sums, len(loaded.regions))
            with console.progress() as progress:
                field = build(
                    loaded.gaussians, loaded.cameras, loaded.regions, self.settings(loaded.raster_preset),
                    embedding_model=loaded.model, words=loaded.words, geometry_path=loaded.source, sums=sums,
                    check_fit=not self.no_check_fit, progress=progress,
                )  # fmt: skip
            save_field(output, field, sums, self.keep_sums, self.embed_geometry, self.weight_bits)
            bytes_of_sums = sums.bytes if self.keep_sums else None
        report_field(console, field, out, bytes_of_sums, device, time.perf_counter() - started)
        return None

    def _of_splat(self, console: Console) -> Build | None:
        """Make a scene of a splat alone; returns the build of that scene. None where there is a scene."""
        from scoup.base.errors import InputError
        from scoup.base.shares import Share
        from scoup.cli.extract import Extract
        from scoup.cli.views import is_splat, make_scene

        if not is_splat(self.scene):
            if self.segmenter is not None or self.embedder is not None:
                raise InputError("--segmenter and --embedder are for a splat alone; run scoup extract first")
            return None
        if self.shard is not None or not Share.of_environment().is_everything:
            raise InputError(f"{self.scene}: make its scene first, with scoup views and scoup extract")
        if self.gaussians is not None:
            raise InputError(f"{self.scene}: is a splat; pass the scene, and the splat with --gaussians")
        out = self.out or Path(f"{self.scene.stem}.scoup")
        check_field_name(out)
        check_field_output(out, self.overwrite, self.keep_sums)
        folder = out.with_name(f"{out.stem}_views")
        models = Extract(device=self.device, segmenter=self.segmenter, embedder=self.embedder or CLIP_MODEL)
        make_scene(console, self.scene, folder, models, self.overwrite)
        return replace(self, scene=folder, gaussians=self.scene, out=out, segmenter=None, embedder=None)

    def _write_shard(self, console: Console, out: Path, loaded: _Loaded) -> None:
        """Rasterise a share of the views, keep it and report."""
        from scoup.base.locks import locked_output
        from scoup.base.shares import Share
        from scoup.uplift.storage.paths import shard_path

        share = Share.parse(self.shard or "")
        path = shard_path(out, share)
        started = time.perf_counter()
        with locked_output(path, self.overwrite, is_folder=True) as output:
            made, size = self._make_shard(console, output, loaded, share, not self.no_check_fit)
        seconds = time.perf_counter() - started
        views = len(made.sources.views)
        console.say(
            f"{path}: {counted(views, 'view')} of {made.n_views:,}, {size / 1e6:.1f} MB, in {seconds:.0f} s; when all "
            "shards are there: scoup merge"
        )
        record = {"shard": path, "bytes": size, "views": views, "of_views": made.n_views}
        console.result({**record, "seconds": round(seconds, 2)})

    def _make_shard(
        self, console: Console, output: Output, loaded: _Loaded, share: Share, check_fit: bool
    ) -> tuple[Shard, int]:
        """Make the shard of an output; returns it, and its bytes."""
        from scoup.uplift.shards import add_shard

        with self._region_sums(output.path, loaded) as sums, console.progress() as progress:
            self._announce(console, sums, len(share.of(range(len(loaded.regions)))))
            made = add_shard(
                sums, loaded.gaussians, loaded.cameras, loaded.regions, share, embedding_model=loaded.model,
                words=loaded.words, geometry_path=loaded.source, check_fit=check_fit, progress=progress,
            )  # fmt: skip
            size = sums.bytes
            assert sums.path is not None
            output.take(sums.path)
        return made, size

    def _build_together(
        self, console: Console, out: Path, loaded: _Loaded, share: Share, device: str
    ) -> None:
        """Make the shard of one of several processes; the first of them merges all."""
        from scoup.base.atomic import remove
        from scoup.base.heartbeats import heartbeats, reported_once, wait_for_parts, wait_until_taken
        from scoup.base.locks import lock_path, locked_output
        from scoup.base.shares import Share
        from scoup.cli.merge import save_merged
        from scoup.uplift.checkpoint import resume_shard
        from scoup.uplift.storage.paths import shard_path

        shards = [shard_path(out, Share(number, share.count)) for number in range(share.count)]
        path, started = shards[share.number], time.perf_counter()
        if not share.is_first:
            part_lock = locked_output(path, overwrite=True, is_folder=True)
            with reported_once(share), part_lock as part, heartbeats(part):
                resume_shard(path)  # of an earlier run, which may have been of another scene
                self._make_shard(console, part, loaded, share, check_fit=False)
                wait_until_taken(part, path, lock_path(out))
            return
        with reported_once(share), locked_output(out, self.overwrite) as whole, heartbeats(whole):
            with locked_output(path, overwrite=True, is_folder=True) as part:
                resume_shard(path)
                self._make_shard(console, part, loaded, share, not self.no_check_fit)
            wait_for_parts(whole, [lock_path(path) for path in shards[1:]])
            found = save_merged(console, self, whole, shards, device, self.keep_sums, loaded.source)
            for path in shards:
                remove(path)
        report_field(console, found.field, out, found.bytes_of_sums, device, time.perf_counter() - started)

    def _load(self, console: Console, device: str) -> _Loaded:
        """Read the scene."""
        from scoup.io import load_gaussians
        from scoup.io.scene_parts import find_splat
        from scoup.uplift.provenance import embedding_source

        splat = find_splat(self.scene, self.gaussians)
        source = splat.path
        raster_preset = splat.preset if self.raster_preset == "auto" else self.raster_preset
        self.settings(raster_preset)  # a mistake shows before the long work
        gaussians = load_gaussians(source).to(device)
        cameras, regions, features = self.load_views(self.scene)
        model, words = embedding_source(features, regions, self.model)
        if words is None:
            model = model or _usual_model(regions)
        console.say(
            f"{counted(len(gaussians), 'Gaussian')}, {counted(len(regions), 'view')} with regions of "
            f"{counted(len(cameras), 'camera')}"
        )
        return _Loaded(gaussians, cameras, regions, source, raster_preset, model, words)

    def _output(self, share: Share) -> Path:
        """The field to write, after checking that what is written now may be written."""
        from scoup.base.errors import InputError
        from scoup.base.locks import complete
        from scoup.base.shares import Share
        from scoup.io import check_output
        from scoup.io.camera_sources import scene_folder
        from scoup.uplift.storage.paths import shard_path

        out = self.out or Path(f"{scene_folder(self.scene).resolve().name}.scoup")
        check_field_name(out)
        if self.shard is not None:
            if not share.is_everything:
                raise InputError(
                    "pass --shard, or run under torchrun, not both: torchrun divides the views itself"
                )
            self._check_alone_with_shard()
            path = shard_path(out, Share.parse(self.shard))
            complete(path)
            check_output(path, self.overwrite, is_folder=True)
            return out
        if self.sums is not None and not share.is_everything:
            raise InputError("--sums needs one process: nothing is rasterised; run without torchrun")
        if self.sums is not None and self.keep_sums:
            raise InputError("--sums and --keep-sums do not go together: the sums are kept already")
        check_field_output(out, self.overwrite, self.keep_sums)
        return out

    def _check_alone_with_shard(self) -> None:
        """Refuse options that a shard has no use for."""
        from scoup.base.counts import listed
        from scoup.base.errors import InputError

        if self.sums is not None:
            raise InputError("--sums and --shard do not go together: there is nothing to rasterise")
        later = self.given() + (["--keep-sums"] if self.keep_sums else [])
        if later:
            raise InputError(f"--shard makes region sums only; pass {listed(later, 9)} to scoup merge")

    def _region_sums(self, out: Path, loaded: _Loaded) -> AbstractContextManager[RegionSums]:
        """The sums named, or those in the folder beside the output in which a build keeps what it has done."""
        from scoup.uplift.checkpoint import checkpoint
        from scoup.uplift.region_sums import RegionSums

        if self.sums is not None:
            return nullcontext(RegionSums.open(self.sums))
        how = {"weights": self.sums_weights, "least_weight": self.least_weight}
        return checkpoint(out, loaded.gaussians, loaded.regions, loaded.raster_preset, **how)

    def _announce(self, console: Console, sums: RegionSums, views: int) -> None:
        """Report what is resumed, and what an interruption leaves."""
        from scoup.uplift.checkpoint import resume_message

        if self.sums is None:
            before = console.kept()
            console.kept = lambda: kept(len(sums), views, "views", "codes" if sums.codes else "", before)
        if message := resume_message(sums, views):
            console.say(message)


def _usual_model(regions: Regions) -> str:
    """LangSplat's CLIP model for features that do not name theirs; "" where it cannot have made them."""
    rows = regions.load_embeddings(regions.view_names[0], regions.levels[0])
    return CLIP_MODEL if rows.shape[1] == CLIP_DIM else ""
