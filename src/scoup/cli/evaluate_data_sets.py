"""scoup eval lerf-ovs, 3d-ovs, mipnerf360: one data set by its own protocol."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from scoup.cli.build import CLIP_MODEL
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalInteger, OptionalPath, OptionalText, WritesCommon, common_last

if TYPE_CHECKING:
    from torch import Tensor

    from scoup.evaluate.datasets import EvalScene, Places
    from scoup.evaluate.predictions import PredictionCache
    from scoup.evaluate.scores import PairScore, SceneScore
    from scoup.evaluate.scoring import Asked
    from scoup.field.language_field import LanguageField
    from scoup.uplift.build_settings import BuildSettings

Names = tyro.conf.UseAppendAction[tuple[str, ...]]


@dataclass(frozen=True, kw_only=True)
class DataSetOptions(WritesCommon):
    """Options of all commands that read a data set."""

    root: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROOT", help_behavior_hint="")]
    """Folder of the data set, with a folder for each scene."""
    scenes: Annotated[Names, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = ()
    """Scenes to score; repeat it for several. Default: all that have labels."""
    gaussians: OptionalText = None
    """The trained splats, with {scene} for the scene's name. Default: the one in each scene's folder."""
    features: OptionalText = None
    """The region features, with {scene} for the scene's name. Default: language_features in each scene's folder."""
    images: OptionalText = None
    """The photographs, with {scene} for the scene's name. Default: images, images_2, images_4 or images_8."""
    undistort: Flag = False
    """Accept cameras with lens distortion: their region maps are undistorted as they are read."""
    text: Annotated[OptionalText, tyro.conf.arg(metavar="TABLE|MODEL", help_behavior_hint="")] = None
    """Turns labels into vectors. Default: text.npz of the scene or of ROOT, else the CLIP model of LangSplat."""
    out: OptionalPath = None
    """Folder for everything that is made. Default: eval_<data set> here."""

    data_set_name: ClassVar[str] = "lerf-ovs"

    def places(self) -> Places:
        """Where the parts of scenes lie."""
        from scoup.evaluate.datasets import Places

        return Places(self.gaussians, self.features, self.images)

    def folder(self) -> Path:
        """For outputs."""
        return self.out or Path(f"eval_{self.data_set_name}")


@dataclass(frozen=True, kw_only=True)
class Scored(DataSetOptions):
    """Options of the protocols."""

    rules: Literal["scoup", "langsplatv2", "langsplat"] = "scoup"
    """Whose constants turn relevancy into masks and points; langsplat names none but for LERF-OVS."""
    preset: Literal["default", "paper"] = "default"
    """How fields are built: default answers best, paper is the method as published (Adam, slow)."""
    n_atoms: OptionalInteger = None
    """Atoms in the codebook of each level (L). Default: the preset's."""
    k: OptionalInteger = None
    """Atoms in the code of a region (K). Default: the preset's."""
    seed: int = 0
    """Of the codebook's start."""
    rebuild: Flag = False
    """Build fields again that are there already."""
    selection: Flag = False
    """Also score by the 3D-selection protocol, in tables of its own."""
    sheets: Literal["worst", "none"] = "worst"
    """Pictures of the worst answered queries of each scene."""

    def run(self, console: Console) -> None:
        """Build what is missing, predict, score, write."""
        from scoup.evaluate.datasets import data_set_preset, find_data_set, find_scenes, open_scene
        from scoup.evaluate.predictions import PredictionCache
        from scoup.evaluate.scoring import (
            build_field,
            encode_labels,
            score_field,
            score_selection,
            text_source,
        )
        from scoup.uplift.build_settings import build_settings

        data_set = find_data_set(self.data_set_name)
        rules = data_set_preset(data_set, self.rules)
        settings = build_settings(self.preset, n_atoms=self.n_atoms, k=self.k, seed=self.seed)
        out = self.folder()
        self._check_outputs(out)
        names = find_scenes(data_set, self.root, self.scenes)
        opened = [open_scene(data_set, self.root, name, self.places(), self.undistort) for name in names]
        for scene in opened:
            console.say(
                f"{scene.name}: {len(scene.frames)} labelled frames, {scene.n_pairs} (frame, label) pairs"
            )
        cache = PredictionCache(out / "cache")
        scores: list[SceneScore] = []
        selected: list[SceneScore] = []
        levels: tuple[str, ...] = ()
        with console.progress() as progress:
            for scene in opened:
                source = text_source(self.root, scene, self.text, CLIP_MODEL)
                asked = encode_labels(scene, source, self.device)
                path = out / "fields" / f"{scene.name}.scoup"
                field = build_field(scene, path, settings, source, self.rebuild, self.device, progress)
                levels = field.levels
                score = score_field(data_set, scene, path, field, asked, rules, cache, progress)
                scores.append(score)
                if self.selection:
                    selected.append(score_selection(scene, field, asked))
                if self.sheets == "worst":
                    self._draw(out, scene, field, path, asked, score, cache)
        self._report(console, out, scores, selected, levels, settings)

    def _stem(self) -> str:
        return f"{self.data_set_name}_{self.rules}"

    def _check_outputs(self, out: Path) -> None:
        from scoup.io import check_output

        for suffix in (".md", ".json", ".tex"):
            check_output(out / f"{self._stem()}{suffix}", self.overwrite)

    def _report(
        self,
        console: Console,
        out: Path,
        scores: list[SceneScore],
        selected: list[SceneScore],
        levels: tuple[str, ...],
        settings: BuildSettings,
    ) -> None:
        from dataclasses import asdict

        from scoup.base.version import VERSION
        from scoup.evaluate.datasets import find_data_set
        from scoup.evaluate.tables import Report
        from scoup.evaluate.writing import write_report

        data_set = find_data_set(self.data_set_name)
        shared = {"software": f"scoup {VERSION}", "build": asdict(settings), "root": str(self.root)}
        reports = {
            self._stem(): Report(scores[0].protocol, self.rules, tuple(scores), data_set.scenes, shared)
        }
        if selected:
            name = f"{self.data_set_name}_3d-selection"
            note = "Another protocol than the 2D ones: never set the two side by side."
            rules = selected[0].preset
            reports[name] = Report(
                selected[0].protocol, rules, tuple(selected), data_set.scenes, shared, (note,)
            )
        records = {}
        for stem, report in reports.items():
            records[stem] = write_report(report, out, stem, levels, self.overwrite)
            for line in (out / f"{stem}.md").read_text().split("## ")[1:3]:
                console.say("\n" + line.strip())
        console.say(
            f"\n{out}: tables (.md, .json, .tex), fields, cache" + (", failures" * (self.sheets == "worst"))
        )
        console.result({"out": out, "reports": records})

    def _draw(
        self,
        out: Path,
        scene: EvalScene,
        field: LanguageField,
        path: Path,
        asked: Asked,
        score: SceneScore,
        cache: PredictionCache,
    ) -> None:
        """Write the failure sheet of a scene; its maps are in the cache."""
        from dataclasses import replace

        from scoup.evaluate.datasets import data_set_preset, find_data_set
        from scoup.evaluate.failures import failure_sheet
        from scoup.evaluate.predictions import file_digest
        from scoup.evaluate.protocols.threed_ovs import LEVELS_ASKED
        from scoup.evaluate.scoring import predict
        from scoup.io import save_png
        from scoup.raster import render_colors

        data_set = find_data_set(self.data_set_name)
        cameras = {frame.name: camera for frame, camera in scene.frames}
        truths = {frame.name: frame for frame, _ in scene.frames}
        digest = file_digest(path)

        def maps(pair: PairScore) -> Tensor:
            only = [(frame, camera) for frame, camera in scene.frames if frame.name == pair.frame]
            ((frame, found),) = predict(data_set, replace(scene, frames=only), field, digest, asked, cache)
            return found[:, frame.labels.index(pair.label)]

        def color(name: str, width: int, height: int) -> Tensor:
            return render_colors(field.gaussians, cameras[name].resized(width, height)).cpu()

        rows = range(len(field.levels))
        asks = tuple(i for i in rows if data_set.name != "3d-ovs" or field.levels[i] in LEVELS_ASKED)
        rules = data_set_preset(data_set, self.rules)
        sheet = failure_sheet(score, truths, maps, color, rules, asks, field.levels)
        save_png(sheet, out / "failures" / f"{scene.name}_{self.rules}.png", overwrite=True)


@common_last
@dataclass(frozen=True, kw_only=True)
class LerfOvs(Scored):
    """Score LERF-OVS (figurines, ramen, teatime, waldo_kitchen): masks and points, with the rules of its protocol.

    Builds the fields that are missing, predicts once into a cache, and writes tables by query, by scene and overall,
    with intervals, published figures marked as such, and the worst answers as pictures.
    """

    data_set_name: ClassVar[str] = "lerf-ovs"


@common_last
@dataclass(frozen=True, kw_only=True)
class ThreeDOvs(Scored):
    """Score 3D-OVS (bed, bench, room, sofa, lawn): masks, with the rules of its protocol."""

    data_set_name: ClassVar[str] = "3d-ovs"


@common_last
@dataclass(frozen=True, kw_only=True)
class MipNerf360(Scored):
    """Score Mip-NeRF 360 with the GAGS annotations (room, counter, garden, bonsai): masks, with the rules of its
    protocol."""

    data_set_name: ClassVar[str] = "mipnerf360"
