"""scoup update: views added to a field, removed from it, or changed; or its codes on an edited splat."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

import tyro

from scoup.base.counts import counted
from scoup.cli.build_options import check_field_output
from scoup.cli.console import Console, kept
from scoup.cli.options import OptionalPath, OptionGroups
from scoup.cli.query_options import FieldOptions
from scoup.cli.scene_options import ViewOptions

if TYPE_CHECKING:
    from scoup.field.language_field import LanguageField
    from scoup.scene.cameras import Camera, Cameras
    from scoup.scene.regions import Regions
    from scoup.uplift.checkpoint import UpdateCopy

Names = Annotated[
    tyro.conf.UseAppendAction[tuple[str, ...]], tyro.conf.arg(metavar="NAME", help_behavior_hint="")
]


@dataclass(frozen=True, kw_only=True)
class Update(FieldOptions, ViewOptions):
    """Add, replace or remove views of a field, or carry its codes over to an edited splat.

    Views need a field that was built with --keep-sums. Only the named views are rasterised; then all views vote. Atoms
    and the codes of other regions stay. To resume an interrupted update, run the same command again.

    With --edited, each Gaussian of the splat gets the codes of the nearest Gaussian of the field that it lies in;
    no view is rasterised, and no region sums are needed.
    """

    option_groups: ClassVar[OptionGroups] = {
        "scene": "scene",
        "field": "sums",
        "splat": "edited",
        "output": "out weight_bits",
    }

    scene: OptionalPath = None
    """Folder with the cameras of the views to add, as for scoup build."""
    add: Names = ()
    """Name of a camera to add or replace; repeat it for several. all: every camera with features that is new, or whose
    region maps or pose have changed."""
    remove: Names = ()
    """Name of a view to remove; repeat it for several."""
    new_atoms: int = 0
    """Most atoms to add per level for regions of a new view that the codebook explains badly."""
    sums: OptionalPath = None
    """The region sums of the field. Default: FIELD.sums."""
    edited: OptionalPath = None
    """The splat of the field after an edit, in the same frame: Gaussians deleted, appended, reordered or rounded."""
    out: OptionalPath = None
    """The field to write; its region sums go beside it. Default: FIELD, which needs --overwrite."""
    weight_bits: Literal[8, 16] = 16
    """Bits of a stored code weight."""

    def run(self, console: Console) -> None:
        """Update, save and report."""
        from scoup.base.errors import InputError

        if self.edited is not None:
            self._transfer(console, self.edited)
            return
        if not self.add and not self.remove:
            raise InputError("say what to do: --add NAME, --add all, --remove NAME, or --edited SPLAT")
        self._change_views(console)

    def _change_views(self, console: Console) -> None:
        """Add and remove views."""
        from scoup.base.locks import locked_output
        from scoup.uplift.checkpoint import copy_for_update, save_field
        from scoup.uplift.update import update

        out, source = self._output(also_sums=True), self._source()
        # Before reading: nobody else changes the field meanwhile.
        with locked_output(out, self.overwrite) as output:
            field = self.open_field()
            cameras, regions = self._changed_views(field, source)
            with copy_for_update(source, out, cameras, regions) as copied, console.progress() as progress:
                _announce(console, copied, out)
                updated = update(
                    field, copied.sums, cameras, regions, self.remove, self.new_atoms,
                    check_fit=not self.no_check_fit and not copied.n_added, progress=progress,
                )  # fmt: skip
                save_field(output, updated, copied.sums, True, field.geometry_path is None, self.weight_bits)
        total = len(updated.info.provenance["views"])
        console.say(
            f"{out}: {counted(len(cameras), 'view')} added, {len(self.remove)} removed, {total:,} in all; "
            f"{counted(updated.n_atoms, 'atom')} a level"
        )
        console.result(
            {
                "field": out,
                "added": [camera.name for camera in cameras],
                "removed": list(self.remove),
                "views": total,
                "atoms": updated.n_atoms,
            }
        )

    def _transfer(self, console: Console, edited: Path) -> None:
        """Carry the codes over to another splat, save and report."""
        from scoup.base.errors import InputError
        from scoup.base.locks import locked_output
        from scoup.io import load_gaussians
        from scoup.uplift.checkpoint import save_field
        from scoup.uplift.storage.paths import sums_path
        from scoup.uplift.transfer import transfer

        if self.add or self.remove or self.scene is not None:
            raise InputError(
                "--edited carries codes over and takes no views; to let views vote, build a field of the edited splat"
            )
        out = self._output(also_sums=False)
        with locked_output(out, self.overwrite) as output:
            field, gaussians = self.open_field(), load_gaussians(edited)
            if gaussians.fingerprint() == field.fingerprint:
                raise InputError(f"nothing to do: {edited} is the splat of {self.field} already")
            embed = field.geometry_path is None
            made = transfer(field, gaussians, geometry_path=None if embed else edited)
            save_field(output, made, None, True, embed, self.weight_bits)
        if sums_path(out).is_dir():
            console.warn(f"{sums_path(out)}: are region sums of another splat than {out}; remove them")
        record = made.info.provenance["updates"][-1]["transferred"]
        console.say(
            f"{out}: {counted(record['coded'], 'Gaussian')} got codes, {record['not_coded']:,} lie in no Gaussian of "
            f"{self.field} and have none"
        )
        console.result({"field": out, "coded": record["coded"], "not_coded": record["not_coded"]})

    def _output(self, also_sums: bool) -> Path:
        """The field to write, after checking that it, and its region sums, may be written."""
        from scoup.base.locks import complete

        out = self.out or self.field
        complete(self.field)
        check_field_output(out, self.overwrite, also_sums)
        return out

    def _source(self) -> Path:
        """The folder of the field's region sums."""
        from scoup.base.errors import MissingFileError
        from scoup.uplift.storage.paths import sums_path

        source = self.sums or sums_path(self.field)
        if not source.is_dir():
            problem = "is not there: the region sums of the field are needed"
            remedy = "build the field with --keep-sums, or name them with --sums"
            raise MissingFileError(source, problem, remedy)
        return source

    def _changed_views(self, field: LanguageField, source: Path) -> tuple[list[Camera], Regions | None]:
        """The cameras to add and their regions, after checking that field and sums belong together."""
        from scoup.base.errors import InputError
        from scoup.uplift.rasterise import changed_views
        from scoup.uplift.region_sums import RegionSums
        from scoup.uplift.update import field_codes

        sums = RegionSums.open(source)
        field_codes(field, sums)
        if not self.add:
            return [], None
        if self.scene is None:
            raise InputError("name the folder with the cameras of the views to add: --scene SCENE")
        cameras, regions, _ = self.load_views(self.scene)
        chosen = self._chosen(cameras, regions)
        changed = changed_views(sums, chosen, regions, field.gaussians.device)
        if not changed and not self.remove:
            raise InputError("nothing to do: these views are in the field, and have not changed")
        return changed, regions

    def _chosen(self, cameras: Cameras, regions: Regions) -> list[Camera]:
        """The cameras that --add names."""
        from scoup.base.errors import UnknownNameError
        from scoup.scene.cameras import Cameras
        from scoup.uplift.rasterise import cameras_with_regions

        known = Cameras(cameras_with_regions(cameras, regions))
        if "all" in self.add:
            return list(known)
        try:
            return list(dict.fromkeys(known[name] for name in self.add))
        except UnknownNameError as error:
            raise UnknownNameError("camera with regions", error.name, known.names, str(self.scene)) from error


def _announce(console: Console, copied: UpdateCopy, out: Path) -> None:
    """Report what is resumed, and what an interruption leaves."""
    total = len(copied.add)
    if copied.n_added:
        console.say(f"{out}: resumes an interrupted update: {copied.n_added} of {total} views are done")
    console.kept = lambda: kept(copied.n_added, total, "views")
