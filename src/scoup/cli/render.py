"""scoup render: what a field looks like, as pictures or an animation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scoup.cli.asking import AsksText, AsksViews
from scoup.cli.console import Console, unique_slugs

AXES = 8  # directions of embedding space among which the three colours are chosen

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from scoup.cameras import Camera
    from scoup.field import LanguageField
    from scoup.raster import View


@dataclass(frozen=True, kw_only=True)
class Render(AsksText, AsksViews):
    """Render views of a field: colours, codes as colours (same code, same colour), or relevancy to a text."""

    what: Literal["color", "codes", "relevancy"] = "color"
    """color: the splat. codes: a projection of the rendered codes to RGB. relevancy: needs --query."""
    query: str | None = None
    """The text whose relevancy is drawn."""
    level: str = "m"
    """Level of the codes (relevancy takes the level that answers best)."""
    out: Path | None = None
    """Folder of the pictures, or a .webp or .gif file for an animation. Default: <name of FIELD>_<what> here."""
    frames_per_second: float = 12.0
    """Of an animation."""

    def run(self, console: Console) -> None:
        """Render each camera asked for."""
        from scoup.errors import InputError
        from scoup.io import check_output, save_png

        if (self.what == "relevancy") != (self.query is not None):
            raise InputError("--what relevancy and --query TEXT belong together")
        out = self.out or Path(f"{self.field.stem}_{self.what}")
        animation = out.suffix.lower() in (".webp", ".gif")
        if not self.frames_per_second > 0:
            raise InputError(f"--frames-per-second must be above 0, got {self.frames_per_second}")
        field = self.open_field()
        field.level_index(self.level)
        cameras = self.open_cameras(field)
        files = [out / f"{name}.png" for name in unique_slugs([camera.stem for camera in cameras])]
        for path in [out] if animation else files:
            check_output(path, self.overwrite)
        text = None if self.query is None else self.encode(field, [self.query])

        frames: list[np.ndarray] = []
        with console.progress() as progress:
            progress("render", 0, len(cameras))
            for done, (camera, path) in enumerate(zip(cameras, files, strict=True), start=1):
                picture = self._picture(field, camera, text)
                if animation:
                    frames.append(picture)
                else:
                    save_png(picture, path, self.overwrite)
                progress("render", done, len(cameras))
        if animation:
            _save_animation(frames, out, self.frames_per_second, self.overwrite)
        written = [out] if animation else files
        console.say(f"{len(cameras)} views rendered to {out}")
        console.result({"out": out, "files": written})

    def _picture(self, field: LanguageField, camera: Camera, text: tuple[Tensor, Tensor] | None) -> np.ndarray:
        """[H, W, 3] uint8."""
        from scoup.pictures import as_picture, heat_map
        from scoup.query import segment
        from scoup.raster import render_colors

        view = field.look(camera)
        if self.what == "codes":
            return self._code_picture(field, camera, view)
        rgb = render_colors(field.gaussians, camera, view)
        if text is None:
            return as_picture(rgb)
        maps = field.relevancy(camera, *text, view)[:, 0]
        answer = segment(maps)
        return heat_map(maps[answer.level], rgb, self.query or "", field.levels[answer.level], answer.score)

    def _code_picture(self, field: LanguageField, camera: Camera, view: View) -> np.ndarray:
        from scoup.codes import SparseCodes
        from scoup.pictures import code_basis, code_picture

        level = field.level_index(self.level)
        # Colours should tell meanings apart, so atoms are placed by their embeddings first; and the same code should
        # have the same colour in every view, so the axes come from the Gaussians, not from the picture.
        atoms = field.codebook[level].cpu()
        directions = _leading_directions(atoms, AXES)
        codes = SparseCodes(field.code_indices[:, level].cpu(), field.code_weights[:, level].float().cpu(), field.n_atoms)
        basis = code_basis(codes.to_dense() @ atoms @ directions)
        rendered = field.render_codes(camera, view)[level].cpu()
        return code_picture(rendered @ atoms @ directions, basis)


def _leading_directions(atoms: Tensor, count: int) -> Tensor:
    """[D, count] leading right singular vectors of the atoms [L, D]."""
    import torch

    return torch.linalg.svd(atoms, full_matrices=False).Vh[:count].T


def _save_animation(frames: list[np.ndarray], path: Path, frames_per_second: float, overwrite: bool) -> None:
    from PIL import Image

    from scoup.errors import InputError
    from scoup.io import atomic_file

    if len({frame.shape for frame in frames}) > 1:
        raise InputError(f"{path}: the views differ in size; an animation needs one size (see --camera)")
    pictures = [Image.fromarray(frame) for frame in frames]
    options = {"save_all": True, "append_images": pictures[1:], "duration": round(1000 / frames_per_second), "loop": 0}
    with atomic_file(path, overwrite) as stream:
        pictures[0].save(stream, format=path.suffix[1:].upper(), **options)
