"""Videos, read again by ffmpeg."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from messages import refuses
from scoup.base import ScoupError
from scoup.pictures.video import check_video_writer, save_video

ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")


def frames(count: int, height: int = 36, width: int = 48) -> list[np.ndarray]:
    """A grey that grows lighter, with a red square that moves."""
    made = []
    for number in range(count):
        frame = np.full((height, width, 3), 30 + 10 * number, np.uint8)
        frame[8:16, 4 * number : 4 * number + 8] = (220, 20, 20)
        made.append(frame)
    return made


def read(path: Path) -> tuple[dict, list[np.ndarray]]:
    reader = ffmpeg.read_frames(str(path))
    facts = next(reader)
    width, height = facts["size"]
    return facts, [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]


@pytest.mark.parametrize(("height", "width"), [(36, 48), (37, 49)])
def test_a_video_shows_its_frames(tmp_path: Path, height: int, width: int) -> None:
    given = frames(9, height, width)
    for name in ("a.mp4", "b.mp4"):
        save_video(iter(given), tmp_path / name, 12.5)
    assert (tmp_path / "a.mp4").read_bytes() == (tmp_path / "b.mp4").read_bytes()
    facts, found = read(tmp_path / "a.mp4")
    assert (facts["size"], facts["fps"], len(found)) == ((48, 36), 12.5, 9)
    for one, other in zip(given, found, strict=True):
        assert np.abs(one[:36, :48].astype(int) - other).mean() < 12


def test_what_makes_no_video_is_refused(tmp_path: Path) -> None:
    for given in ([], [*frames(2), *frames(1, 20, 20)], frames(1, 1, 9)):
        with refuses():
            save_video(given, tmp_path / "a.mp4", 24)


def test_a_missing_ffmpeg_and_a_missing_package_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def nowhere() -> str:
        raise RuntimeError("No ffmpeg exe could be found")

    monkeypatch.setattr(ffmpeg, "get_ffmpeg_exe", nowhere)
    with refuses(ScoupError):
        check_video_writer()
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with refuses(ScoupError):
        check_video_writer()
