"""scoup update: views added to a field, removed from it, or taken in again because their regions have changed."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalPath, common_last
from scoup.cli.query_options import FieldOptions

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.scene.cameras import Camera
    from scoup.scene.regions import Regions
    from scoup.uplift.region_sums import RegionSums

Names = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME", help_behavior_hint="")
]


@common_last
@dataclass(frozen=True, kw_only=True)
class Update(FieldOptions):
    """Add views to a field, remove some, or take in anew those whose regions have changed.

    The field must have been built with --keep-sums. Only the views named are rasterised; then all vote again. The atoms
    of the field and the codes of its other regions stay.
    """

    scene: OptionalPath = None
    """Folder with the cameras of the views to add, as for scoup build."""
    features: OptionalPath = None
    """Folder of their region features. Default: SCENE/language_features."""
    images: OptionalPath = None
    """Folder of the photographs, as for scoup build."""
    downscale: Annotated[
        Literal[1, 2, 4, 8] | None, tyro.conf.arg(metavar="{1,2,4,8}", help_behavior_hint="")
    ] = None
    """Work at 1/N of the full image size, as the field was built."""
    undistort: Flag = False
    """Accept cameras with lens distortion."""
    add: Names = ()
    """Name of a camera to add, or to take in anew; repeat it for several. all: every one with features that is not in
    the field, or whose region maps or camera have changed."""
    remove: Names = ()
    """Name of a view to leave out; repeat it for several."""
    new_atoms: int = 0
    """Add at most so many atoms a level for regions of a new view that the codebook explains badly."""
    sums: OptionalPath = None
    """The region sums of the field. Default: FIELD.sums."""
    out: OptionalPath = None
    """The field to write; its region sums go beside it. Default: FIELD, which needs --overwrite."""
    weight_bits: Literal[8, 16] = 16
    """Bits of a stored code weight."""

    def run(self, console: Console) -> None:
        """Update, save and report."""
        from scoup.base.atomic import atomic_path
        from scoup.base.errors import InputError, MissingFileError
        from scoup.io import check_output
        from scoup.uplift.region_sums import RegionSums, sums_path
        from scoup.uplift.update import codes_of, update

        if not self.add and not self.remove:
            raise InputError("say what to do: --add NAME, --add all, or --remove NAME")
        out = self.out or self.field
        check_output(out, self.overwrite)
        check_output(sums_path(out), self.overwrite)
        source = self.sums or sums_path(self.field)
        if not source.is_file():
            problem = "is not there: the region sums of the field are needed"
            raise MissingFileError(
                source, problem, "build the field with --keep-sums, or name them with --sums"
            )
        field = self.open_field()
        sums = RegionSums.open(source)
        codes_of(field, sums)  # they belong together
        cameras, regions = self._views(field, sums)
        sums.close()
        # Worked on is a copy, so that field and sums change together or not at all.
        with atomic_path(sums_path(out), self.overwrite) as copy:
            shutil.copyfile(source, copy)
            sums = RegionSums.open(copy, writable=True)
            try:
                with console.progress() as progress:
                    updated = update(
                        field, sums, cameras, regions, self.remove, self.new_atoms, progress=progress
                    )
                embedded = field.geometry_path is None
                updated.save(out, self.overwrite, embedded, self.weight_bits)
            finally:
                sums.close()
        added, total = [camera.name for camera in cameras], len(updated.info.provenance["views"])
        console.say(
            f"{out}: {len(added)} views taken in, {len(self.remove)} removed, {total} vote; "
            f"{updated.n_atoms} atoms a level"
        )
        console.result(
            {
                "field": out,
                "added": added,
                "removed": list(self.remove),
                "views": total,
                "atoms": updated.n_atoms,
            }
        )

    def _views(self, field: LanguageField, sums: RegionSums) -> tuple[list[Camera], Regions | None]:
        """The cameras to take in, and their regions."""
        from scoup.base.errors import InputError, UnknownNameError
        from scoup.io import load_cameras, load_regions
        from scoup.io.regions.views import FOLDER_NAME
        from scoup.uplift.rasterise import cameras_with_regions, holds_view, read_labels

        if not self.add:
            return [], None
        if self.scene is None:
            raise InputError("name the folder with the cameras of the views to add: --scene SCENE")
        cameras = load_cameras(
            self.scene, self.images, self.downscale, "undistort" if self.undistort else "refuse"
        )
        folder = self.scene if self.scene.is_dir() else self.scene.parent
        regions = load_regions(self.features or folder / FOLDER_NAME, cameras)
        known = cameras_with_regions(cameras, regions)
        if "all" not in self.add:
            by_name = {camera.name: camera for camera in known} | {camera.stem: camera for camera in known}
            unknown = [name for name in self.add if name not in by_name]
            if unknown:
                names = [camera.name for camera in known]
                raise UnknownNameError("camera with regions", unknown[0], names, str(self.scene))
            known = list(dict.fromkeys(by_name[name] for name in self.add))
        device = field.gaussians.device
        changed = [
            camera
            for camera, labels in read_labels(regions, known, device)
            if not holds_view(sums, camera, labels)
        ]
        if not changed and not self.remove:
            raise InputError("nothing to do: these views are in the field, and have not changed")
        return changed, regions
