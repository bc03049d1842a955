"""scoup render: what a field looks like, as pictures or an animation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from scoup.cli.asking import AsksText, AsksViews, sees_nothing
from scoup.cli.console import Console
from scoup.cli.names import unique_slugs
from scoup.cli.options import OptionalPath, OptionalText, common_last
from scoup.cli.staging import check_folder, staged

AXES = 8  # directions of embedding space among which the three colours are chosen
ANIMATIONS = (".webp", ".gif")

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from scoup.field.language_field import LanguageField
    from scoup.raster import Projection
    from scoup.scene.cameras import Camera

    Draw = Callable[[Camera, Projection], np.ndarray]


@common_last
@dataclass(frozen=True, kw_only=True)
class Render(AsksText, AsksViews):
    """Render views of a field: its colours, its codes as colours (same code, same colour), or relevancy to a text."""

    what: Literal["color", "codes", "relevancy"] = "color"
    """color: the splat. codes: their meaning as colours. relevancy: a heat map of the text in --query."""
    query: OptionalText = None
    """The text whose relevancy is drawn."""
    level: OptionalText = None
    """Level of the codes: s, m or l (relevancy takes the level that answers best). Default: m."""
    out: OptionalPath = None
    """Folder, .png (one view), .webp or .gif (animation). Default: folder <name of FIELD>_<what> here."""
    frames_per_second: float = 12.0
    """Speed of an animation."""

    def run(self, console: Console) -> None:
        """Render each camera asked for."""
        from scoup.base.errors import InputError
        from scoup.io import save_png

        if (self.what == "relevancy") != (self.query is not None):
            raise InputError("--what relevancy and --query TEXT belong together; give both or neither")
        if not 0.1 <= self.frames_per_second <= 100:
            raise InputError(f"--frames-per-second must be 0.1 to 100, got {self.frames_per_second}")
        out = self.out or Path(f"{self.field.stem}_{self.what}")
        kind = out.suffix.lower()
        animation = kind in ANIMATIONS
        one_file = animation or kind == ".png"
        if not one_file:
            check_folder(out)
        field = self.open_field()
        draw = self._drawing(field)
        cameras = self.open_cameras(field)
        if kind == ".png" and len(cameras) > 1:
            raise InputError(
                f"{out}: one picture cannot hold {len(cameras)} views; give a folder, .webp or .gif"
            )
        folder = out.parent if one_file else out
        files = [out.name] if one_file else [f"{name}.png" for name in unique_slugs(c.stem for c in cameras)]

        frames: list[np.ndarray] = []
        blind: list[Camera] = []
        with staged(folder, files, self.overwrite) as hidden, console.progress() as progress:
            progress("render", 0, len(cameras))
            for done, camera in enumerate(cameras):
                view = field.project(camera)
                if sees_nothing(field, view):
                    blind.append(camera)
                picture = draw(camera, view)
                if animation:
                    frames.append(picture)
                else:
                    save_png(picture, hidden / files[done])
                progress("render", done + 1, len(cameras))
            self.tell_blind(blind, len(cameras))
            if animation:
                _save_animation(frames, hidden / out.name, self.frames_per_second)
        console.say(f"{len(cameras)} {'view' if len(cameras) == 1 else 'views'} rendered to {out}")
        console.result({"out": out, "files": [(folder / file).as_posix() for file in files]})

    def _drawing(self, field: LanguageField) -> Draw:
        """The function that draws one view as [H, W, 3] uint8."""
        from scoup.models.words import with_everyday
        from scoup.pictures import as_picture, heat_map
        from scoup.query.answers import segment
        from scoup.raster import render_colors

        if self.what == "codes":
            return self._codes_drawing(field)
        if self.query is None:
            return lambda camera, view: as_picture(render_colors(field.gaussians, camera, view))
        vectors = self.encode(field, [self.query])
        canonical = with_everyday(vectors.canonical, vectors.everyday)
        text = self.query

        def draw(camera: Camera, view: Projection) -> np.ndarray:
            maps = field.relevancy(camera, vectors.queries, canonical, view)[:, 0].cpu()
            answer = segment(maps)
            rgb = render_colors(field.gaussians, camera, view).cpu()
            return heat_map(maps[answer.level], rgb, text, field.levels[answer.level], answer.score)

        return draw

    def _codes_drawing(self, field: LanguageField) -> Draw:
        from scoup.pictures import code_basis, code_picture
        from scoup.scene.codes import SparseCodes

        level = len(field.levels) // 2 if self.level is None else field.level_index(self.level)
        # Colours should tell meanings apart, so atoms are placed by their embeddings first; and the same code should
        # have the same colour in every view, so the axes come from the Gaussians, not from the picture.
        atoms = field.codebook[level].cpu()
        placed = atoms @ _leading_directions(atoms, AXES)  # [L, axes]
        indices, weights = field.code_indices[:, level].cpu(), field.code_weights[:, level].float().cpu()
        basis = code_basis(SparseCodes(indices, weights, field.n_atoms).to_dense() @ placed)
        return lambda camera, view: code_picture(
            field.render_codes(camera, view)[level].cpu() @ placed, basis
        )


def _leading_directions(atoms: Tensor, count: int) -> Tensor:
    """[D, count] leading right singular vectors of the atoms [L, D]."""
    import torch

    return torch.linalg.svd(atoms, full_matrices=False).Vh[:count].T


def _save_animation(frames: list[np.ndarray], path: Path, frames_per_second: float) -> None:
    from PIL import Image

    from scoup.base.errors import InputError

    if len({frame.shape for frame in frames}) > 1:
        raise InputError(
            f"{path.name}: the views differ in size, and an animation needs one size; choose views with --camera"
        )
    pictures = [Image.fromarray(frame) for frame in frames]
    pictures[0].save(
        path,
        format=path.suffix[1:].upper(),
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 / frames_per_second),
        loop=0,
    )
