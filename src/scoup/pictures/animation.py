"""Pictures one after the other in one file."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from scoup.base import atomic_file
from scoup.pictures.colors import Picture
from scoup.pictures.lettering import PAPER


def save_animation(frames: Iterable[Picture], path: Path, frames_per_second: float) -> None:
    """Write an endless .webp or .gif, atomically, replacing an existing file. Frames have one width; lower
    ones, with shorter titles, get a margin above."""
    frames = [*frames]
    height = max(frame.shape[0] for frame in frames)
    margins = [np.full((height - frame.shape[0], *frame.shape[1:]), PAPER, np.uint8) for frame in frames]
    pictures = [Image.fromarray(np.concatenate(parts)) for parts in zip(margins, frames, strict=True)]
    encoded = io.BytesIO()
    pictures[0].save(
        encoded,
        format=path.suffix[1:].upper(),
        save_all=True,
        append_images=pictures[1:],
        duration=round(1000 / frames_per_second),
        loop=0,
    )
    with atomic_file(path, overwrite=True) as stream:
        stream.write(encoded.getbuffer())
