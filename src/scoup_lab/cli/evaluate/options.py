"""Options that the commands of scoup eval share."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from scoup.cli import CLIP_MODEL, AllCommon, Console, Names, arg

if TYPE_CHECKING:
    from scoup_lab.evaluate.protocols.pixels import LabelledScene, PixelProtocol
    from scoup_lab.evaluate.report import Report
    from scoup_lab.evaluate.scenes import Places, SceneFiles

Rules = Literal["scoup", "langsplatv2", "langsplat"]


@dataclass(frozen=True, kw_only=True)
class DataSetOptions:
    """Scenes of a data set, and where their parts are."""

    scenes: Names = ()
    """Scenes to score; repeat it for several. Default: all that have labels."""
    gaussians: str | None = None
    """The trained splats, with {scene} for the scene's name. Default: the one in each scene's folder."""
    cameras: str | None = None
    """The cameras (folder or file), with {scene} for the scene's name. Default: those in each scene's folder."""
    features: str | None = None
    """The region features, with {scene} for the scene's name. Default: language_features in each scene's folder."""
    images: str | None = None
    """The photographs, with {scene} for the scene's name. Default: images, images_2, images_4 or images_8."""
    undistort: bool = False
    """Accept cameras with lens distortion: their region maps are undistorted as they are read."""
    text: Annotated[str | None, arg(metavar="TABLE|MODEL")] = None
    """Text encoder of the labels. Default: text.npz of the scene or of ROOT, else the CLIP model of LangSplat."""

    def places(self) -> Places:
        """Return where the parts of scenes lie."""
        from scoup_lab.evaluate.scenes import Places

        return Places(self.gaussians, self.features, self.images, self.cameras, self.undistort)


@dataclass(frozen=True, kw_only=True)
class DataSetVerb:
    """What commands that read a data set have in common."""

    root: Annotated[tyro.conf.Positional[Path], arg(metavar="ROOT")]
    """Folder of the data set, with a folder for each scene."""
    out: Path | None = None
    """Folder for all outputs. Default: eval_<data set> here."""
    data: Annotated[DataSetOptions, arg(name="data set")] = DataSetOptions()
    common: AllCommon = AllCommon()

    def open_labelled(self, console: Console, protocol: PixelProtocol) -> list[LabelledScene]:
        """Open the scenes of a data set of labelled frames, and say what they have."""
        from scoup.base import counted

        names = protocol.find(self.root, self.data.scenes)
        opened = [protocol.open(self.root, name, self.data.places()) for name in names]
        for scene in opened:
            console.say(
                f"{scene.name}: {counted(len(scene.frames), 'labelled frame')}, "
                f"{counted(scene.n_pairs, '(frame, label) pair')}"
            )
        return opened

    def text_source(self, scene: SceneFiles) -> str:
        """Return the table or model that turns the texts of a scene into vectors."""
        from scoup_lab.evaluate.label_vectors import text_source

        return text_source(self.root, scene, self.data.text, CLIP_MODEL)


def kept_in(out: Path, what: str) -> str:
    """Return what an interruption leaves, in words."""
    if not out.is_dir():
        return "nothing was written"
    return f"{what} so far are kept in {out}, run the same command again to continue"


def say_tables(console: Console, report: Report) -> None:
    """Print the tables of a report that are to be shown."""
    for table in report.tables[: report.shown]:
        console.say("\n" + table.markdown())
