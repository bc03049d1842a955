"""Pictures one after the other in one file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from PIL import Image

from scoup.base.errors import InputError
from scoup.pictures.colors import Picture


def save_animation(frames: Sequence[Picture], path: Path, frames_per_second: float) -> None:
    """Write an endless animation, replacing what is there.

    Args:
        frames: [H, W, 3] uint8 each, of one size.
        path: .webp or .gif.
        frames_per_second: its speed.

    Raises:
        InputError: the pictures differ in size.
    """
    if len({frame.shape for frame in frames}) > 1:
        raise InputError(f"{path.name}: the pictures differ in size, and an animation needs one size")
    pictures = [Image.fromarray(frame) for frame in frames]
    pictures[0].save(
        path,
        format=path.suffix[1:].upper(),
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 / frames_per_second),
        loop=0,
    )
