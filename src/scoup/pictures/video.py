"""Pictures one after the other in one file: animations, and videos by imageio-ffmpeg (extra ``scoup[video]``)."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from PIL import Image

from scoup.base import InputError, ScoupError, WriteError, atomic_file
from scoup.pictures.colors import Picture
from scoup.pictures.lettering import PAPER

QUALITY = 7  # of imageio-ffmpeg, 0 to 10
HOW_TO_GET_IT = "videos need the package imageio-ffmpeg: pip install 'scoup[video]', and run again"


def save_frames(frames: Iterable[Picture], path: Path, frames_per_second: float) -> None:
    """Write pictures one after the other: .mp4 by ``save_video``, .webp and .gif by ``save_animation``."""
    save = save_video if path.suffix.lower() == ".mp4" else save_animation
    save(frames, path, frames_per_second)


def check_video_writer() -> None:
    """Check that videos can be written, before the work."""
    try:
        import imageio_ffmpeg
    except ImportError:
        raise ScoupError(HOW_TO_GET_IT) from None
    try:
        imageio_ffmpeg.get_ffmpeg_exe()
    except RuntimeError as error:
        raise ScoupError(
            f"imageio-ffmpeg finds no ffmpeg ({error}); install it, or name it by IMAGEIO_FFMPEG_EXE"
        ) from error


def save_video(frames: Iterable[Picture], path: Path, frames_per_second: float) -> None:
    """Write an mp4 (H.264), replacing an existing file. The same pictures give the same bytes. Frames have one size; an
    odd side loses its last row or column, which H.264 has no place for."""
    check_video_writer()
    import imageio_ffmpeg

    writer, size = None, (0, 0)
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        for frame in frames:
            height, width = (side - side % 2 for side in frame.shape[:2])
            if writer is None:
                if not height or not width:
                    raise InputError(f"{path}: pictures of {frame.shape[1]} x {frame.shape[0]} make no video")
                size = (width, height)
                writer = imageio_ffmpeg.write_frames(
                    str(path),
                    size,
                    fps=frames_per_second,  # pyright: ignore[reportArgumentType]  # any number does
                    quality=QUALITY,
                    macro_block_size=1,
                    ffmpeg_log_level="error",
                    # One thread and no notes on the encoder: the same bytes on every machine with this ffmpeg.
                    output_params=["-threads", "1", "-fflags", "+bitexact", "-flags:v", "+bitexact"],
                )
                writer.send(None)
            if (width, height) != size:
                raise InputError(f"{path}: the pictures differ in size, and a video needs one size")
            writer.send(np.ascontiguousarray(frame[:height, :width]))
    except OSError as error:
        raise WriteError(path, str(error).splitlines()[0] if str(error) else "ffmpeg failed") from error
    finally:
        if writer is not None:
            writer.close()
    if writer is None:
        raise InputError(f"{path}: there is no picture to make a video of")


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
