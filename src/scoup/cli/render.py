"""scoup render: what a field looks like, as pictures or an animation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from scoup.base import InputError, counted, reported, staged, unique_slugs
from scoup.cli.console import Console
from scoup.cli.options import AllCommon, FieldFile, arg
from scoup.cli.query_options import CameraOptions, TextOptions, output_folder

if TYPE_CHECKING:
    from scoup.pictures import Picture
    from scoup.scene import Camera

ANIMATIONS = (".webp", ".gif")
FRAMES_PER_SECOND = 12.0  # of an animation
LONGEST_SIDE = 16384  # of a picture, in pixels


@dataclass(frozen=True, kw_only=True)
class Render:
    """Render views of a field: its colours, its codes as colours (similar meaning, similar colour), or relevancy to a
    text.

    Pictures have a title and, if needed, a legend; --plain omits both.
    """

    field: FieldFile
    """The .scoup file."""
    what: Literal["color", "codes", "relevancy"] = "color"
    """color: the splat. codes: their meaning as colours. relevancy: a heat map of the text in --query."""
    query: str | None = None
    """The text whose relevancy is drawn, with --what relevancy."""
    level: str | None = None
    """Level of the codes: s (fine), m or l (coarse); relevancy takes the level that answers best. Default: m."""
    out: Path | None = None
    """Folder, .png (one view), .webp or .gif (animation). Default: folder <name of FIELD>_<what> here."""
    plain: bool = False
    """Only the pixels of the camera, at exactly its size: no title, no legend. For other programs."""
    scale: float = 1.0
    """Size of the pictures relative to the cameras' own."""
    view: CameraOptions = CameraOptions()
    opening: Annotated[TextOptions, arg(name="field")] = TextOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> None:
        from scoup.io import save_png
        from scoup.pictures import save_frames
        from scoup.query import drawing

        kind = "" if self.out is None else self.out.suffix.lower()
        animation = kind in ANIMATIONS
        one_file = animation or kind == ".png"
        if (self.what == "relevancy") != (self.query is not None):
            raise InputError("--what relevancy and --query TEXT belong together; pass both or neither")
        out = self.out if self.out and one_file else output_folder(self.out, self.field, self.what)
        field = self.opening.open(self.field, self.common.device)
        asked = None if self.query is None else self.opening.question(field, [self.query], always=True)
        draw = drawing(field, self.what, self.level, asked, self.plain)
        cameras = self._scaled(self.view.open_cameras(field, self.field))
        _check_one_file(out, cameras)
        folder = out.parent if one_file else out
        files = [out.name] if one_file else [f"{name}.png" for name in unique_slugs(c.stem for c in cameras)]
        frames: list[Picture] = []
        blind: list[Camera] = []
        with staged(folder, files, self.common.overwrite) as hidden, console.progress() as progress:
            for done, camera in enumerate(reported(cameras, "render", len(cameras), progress)):
                view = field.at(camera)
                if not view.is_visible():
                    blind.append(camera)
                picture = draw(view)
                if animation:
                    frames.append(picture)
                else:
                    save_png(picture, hidden / files[done])
            self.view.check_seen(self.field, blind, len(cameras))
            if animation:
                save_frames(frames, hidden / out.name, FRAMES_PER_SECOND)
        console.say(f"{counted(len(cameras), 'view')} rendered to {out}")
        console.result({"out": out, "files": [(folder / file).as_posix() for file in files]})

    def _scaled(self, cameras: list[Camera]) -> list[Camera]:
        """Return the cameras at the size of --scale."""
        longest = max(max(camera.width, camera.height) for camera in cameras)
        if longest * self.scale > LONGEST_SIDE:
            raise InputError(
                f"--scale {self.scale}: must be at most {LONGEST_SIDE / longest:.3g} for these cameras"
            )
        return [camera.scaled(self.scale) for camera in cameras] if self.scale != 1 else cameras


def _check_one_file(out: Path, cameras: list[Camera]) -> None:
    """Refuse views that do not go into one picture, or one animation, together."""
    kind = out.suffix.lower()
    if kind == ".png" and len(cameras) > 1:
        raise InputError(f"{out}: one picture cannot hold {len(cameras)} views; use a folder, .webp or .gif")
    if kind in ANIMATIONS and len({(camera.width, camera.height) for camera in cameras}) > 1:
        raise InputError(
            f"{out.name}: the views differ in size, and an animation needs one size; choose views with --camera"
        )
