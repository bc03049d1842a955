"""Options of verbs that read the views of a scene: its cameras, photographs and regions."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from scoup.cli.options import Flag, OptionalPath, OptionGroups, WritesCommon, arg

if TYPE_CHECKING:
    from scoup.scene.cameras import Cameras
    from scoup.scene.regions import Regions


@dataclass(frozen=True, kw_only=True)
class ViewOptions(WritesCommon):
    """Options for the views of a scene: their files and their size."""

    option_groups: ClassVar[OptionGroups] = {
        "scene": "features images downscale undistort dataparser_transforms no_check_fit"
    }

    features: OptionalPath = None
    """Folder of region features. Default: SCENE/language_features."""
    images: OptionalPath = None
    """Folder of the photographs. Default: images, images_2, images_4 or images_8 in SCENE."""
    downscale: Annotated[Literal[1, 2, 4, 8] | None, arg()] = None
    """Work at 1/N of the full image size: faster and coarser. Default: the size of the photographs found."""
    undistort: Flag = False
    """Accept cameras with lens distortion: their region maps are undistorted as they are read."""
    dataparser_transforms: OptionalPath = None
    """The dataparser_transforms.json of a nerfstudio training: brings the cameras to the frame of its splat."""
    no_check_fit: Flag = False
    """Skip the check that small renders of the splat match the photographs."""

    def load_cameras(self, scene: Path) -> Cameras:
        """Return the cameras of a scene."""
        from scoup.io import load_cameras

        return load_cameras(
            scene,
            self.images,
            self.downscale,
            "undistort" if self.undistort else "refuse",
            dataparser_transforms=self.dataparser_transforms,
        )

    def load_views(self, scene: Path) -> tuple[Cameras, Regions, Path]:
        """Return cameras and regions of a scene, and the folder of the regions."""
        from scoup.io import load_regions
        from scoup.io.scene_parts import find_features

        cameras = self.load_cameras(scene)
        features = find_features(scene, self.features)
        return cameras, load_regions(features, cameras), features
