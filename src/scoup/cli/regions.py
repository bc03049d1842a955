"""scoup regions: a picture of the regions of a photograph."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from scoup.base.counts import counted
from scoup.base.errors import InputError
from scoup.cli.console import Console
from scoup.cli.options import OptionalPath, WritesCommon, arg, check_number

if TYPE_CHECKING:
    from scoup.scene.cameras import Camera
    from scoup.scene.regions import Regions


@dataclass(frozen=True, kw_only=True)
class ShowRegions(WritesCommon):
    """Draw the regions of one view at three levels beside the photograph, with their numbers where there is room."""

    scene: Annotated[tyro.conf.Positional[Path], arg(metavar="SCENE")]
    """Folder with cameras, photographs and region features."""
    view: str
    """Name of the image, with or without its extension."""
    features: OptionalPath = None
    """Folder of the region features. Default: SCENE/language_features."""
    images: OptionalPath = None
    """Folder of the photographs. Default: images, images_2, images_4 or images_8 in SCENE."""
    out: OptionalPath = None
    """The picture to write, a .png file. Default: <name of the image>_regions.png here."""
    width: int = 1800
    """Width of the picture, in pixels."""

    def run(self, console: Console) -> None:
        """Load, draw, write."""
        from scoup.io import check_output, load_cameras, load_image, load_regions, save_png
        from scoup.io.camera_sources import scene_folder
        from scoup.io.regions.store import RegionStore
        from scoup.pictures import regions_sheet

        check_number("--width", self.width, 200, 20_000)
        cameras = load_cameras(self.scene, self.images, distorted="undistort", missing_images="keep")
        camera: Camera = cameras[self.view]
        out = self.out or Path(f"{camera.stem}_regions.png")
        if out.suffix.lower() != ".png":
            raise InputError(f"{out}: expected a name that ends in .png; choose another")
        check_output(out, self.overwrite)
        folder = self.features or scene_folder(self.scene)
        regions: Regions = load_regions(folder, [camera])
        manifest = RegionStore.open(folder).manifest
        made = _made_by(manifest.settings if manifest else {})
        labels, embeddings = regions.load_view(camera.name, camera.width, camera.height)
        sheet = regions_sheet(load_image(camera), labels, regions.levels, camera.name, made, self.width)
        save_png(sheet, out, self.overwrite)
        counts = {level: len(rows) for level, rows in zip(regions.levels, embeddings, strict=True)}
        covered = {
            level: round(float((plane >= 0).float().mean()), 4)
            for level, plane in zip(regions.levels, labels, strict=True)
        }
        listed = ", ".join(
            f"{level}: {counted(counts[level], 'region')}, {covered[level]:.0%} covered" for level in counts
        )
        console.say(f"{out}: {camera.name} ({listed})")
        console.result({"out": out, "view": camera.name, "regions": counts, "covered": covered})


def _made_by(settings: dict[str, object]) -> str:
    names = [str(settings[key]) for key in ("segmenter", "embedder") if key in settings]
    return "made with " + " and ".join(names) if names else ""
