"""Options that the commands of scoup eval share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from scoup.cli.build import CLIP_MODEL
from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalPath, OptionalText, OptionGroups, WritesCommon

if TYPE_CHECKING:
    from scoup.query.presets import QueryPreset
    from scoup_lab.evaluate.data_sets import LabelledScene
    from scoup_lab.evaluate.studies.study_report import StudyReport
    from scoup_lab.evaluate.studies.study_scene import StudyScene

Names = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME", help_behavior_hint="")
]
Rules = Literal["scoup", "langsplatv2", "langsplat"]


@dataclass(frozen=True, kw_only=True)
class DataSetOptions(WritesCommon):
    """Options of all commands that read a data set."""

    option_groups: ClassVar[OptionGroups] = {
        "data set": "scenes gaussians features images undistort text",
        "output": "out",
    }

    root: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="ROOT", help_behavior_hint="")]
    """Folder of the data set, with a folder for each scene."""
    scenes: Names = ()
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

    def open_scenes(self, console: Console, name: str) -> list[LabelledScene]:
        """The scenes of the data set of that name."""
        from scoup.base.counts import counted
        from scoup_lab.evaluate.data_sets import Places, find_data_set, find_scenes, open_scene

        data_set = find_data_set(name)
        places = Places(self.gaussians, self.features, self.images)
        names = find_scenes(data_set, self.root, self.scenes)
        opened = [open_scene(data_set, self.root, name, places, self.undistort) for name in names]
        for scene in opened:
            console.say(
                f"{scene.name}: {counted(len(scene.frames), 'labelled frame')}, "
                f"{counted(scene.n_pairs, '(frame, label) pair')}"
            )
        return opened

    def text_source(self, scene: LabelledScene) -> str:
        """The table or model that turns the labels of a scene into vectors."""
        from scoup_lab.evaluate.label_vectors import text_source

        return text_source(self.root, scene, self.text, CLIP_MODEL)


@dataclass(frozen=True, kw_only=True)
class StudyOptions(DataSetOptions):
    """Options of commands that try several methods or rules on a data set."""

    option_groups: ClassVar[OptionGroups] = {"data set": "data_set"}

    data_set: Literal["lerf-ovs", "3d-ovs", "mipnerf360", "ref-lerf"] = "lerf-ovs"
    """Layout of ROOT, and whose protocol scores."""
    rules: Rules = "scoup"
    """Whose constants turn relevancy into masks and points."""

    def folder(self) -> Path:
        """For outputs."""
        return self.out or Path(f"eval_{self.data_set}")

    def preset(self) -> QueryPreset:
        """The rules of the protocol."""
        from scoup_lab.evaluate.data_sets import data_set_preset, find_data_set

        return data_set_preset(find_data_set(self.data_set), self.rules)

    def open_study(self, console: Console, stem: str) -> list[StudyScene]:
        """The scenes with splats, regions and text vectors; refuses outputs that are there, before any work."""
        from scoup.io import check_output
        from scoup_lab.evaluate.label_vectors import encode_labels
        from scoup_lab.evaluate.studies.study_scene import open_study_scene

        for suffix in (".md", ".json", ".tex"):
            check_output(self.folder() / f"{stem}{suffix}", self.overwrite)
        scenes = self.open_scenes(console, self.data_set)
        return [open_study_scene(scene, encode_labels(scene, self.text_source(scene))) for scene in scenes]

    def write(self, console: Console, report: StudyReport) -> None:
        """Write and show a report."""
        from scoup_lab.evaluate.plots import HOW_TO_GET_THEM, can_draw

        written = report.write(self.folder(), self.overwrite)
        for table in report.tables:
            console.say("\n" + table.markdown())
        console.say("written: " + ", ".join(str(path) for path in written))
        if report.plots and not can_draw():
            console.say(HOW_TO_GET_THEM)
        console.result({"out": self.folder(), **report.record})
