"""3D-OVS: reading painted masks, the rule of the room, levels, empty masks."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupWarning
from scoup.io import save_png
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols import threed_ovs
from scoup_lab.evaluate.scores import overall


def paint(path: Path, *rows: int, size: tuple[int, int] = (20, 30)) -> None:
    """A mask [20, 30] whose rows first ... last are white."""
    mask = np.zeros(size, np.uint8)
    if rows:
        mask[rows[0] : rows[1]] = 255
    save_png(mask, path, overwrite=True)


def write_scene(folder: Path) -> Path:
    home = folder / "segmentations"
    for frame in ("02", "00"):
        paint(home / frame / "wood table.png", 0, 4)
        paint(home / frame / "wood wall.png", 10, 15)
        paint(home / frame / "lamp.png")
    (home / "classes.txt").write_text("lamp\nwood wall\n\nwood table \n")
    return folder


def test_reading(tmp_path: Path) -> None:
    frames = threed_ovs.read_segmentations(write_scene(tmp_path))
    assert [frame.name for frame in frames] == ["00", "02"]
    assert frames[0].labels == ("lamp", "wood wall", "wood table")
    assert (frames[0].width, frames[0].height) == (30, 20)
    assert frames[0].masks["wood wall"].any(1).nonzero().flatten().tolist() == [10, 11, 12, 13, 14]
    assert not frames[0].masks["lamp"].any()


def test_anything_brighter_than_half_is_inside_whatever_the_mode(tmp_path: Path) -> None:
    write_scene(tmp_path)
    picture = Image.fromarray(np.full((20, 30, 3), 255, np.uint8))
    picture.putpixel((5, 6), (20, 20, 20))
    picture.save(tmp_path / "segmentations" / "00" / "lamp.png")
    mask = threed_ovs.read_segmentations(tmp_path)[0].masks["lamp"]
    assert (~mask).nonzero().tolist() == [[6, 5]]


def test_wood_table_counts_as_wood_wall_in_the_room_only(tmp_path: Path) -> None:
    frames = threed_ovs.read_segmentations(write_scene(tmp_path))
    (first, _) = threed_ovs.united(frames, "room")
    assert first.masks["wood wall"].equal(frames[0].masks["wood wall"] | frames[0].masks["wood table"])
    assert first.masks["wood table"].equal(frames[0].masks["wood table"])
    assert threed_ovs.united(frames, "sofa")[0].masks["wood wall"].equal(frames[0].masks["wood wall"])
    relevancy = torch.zeros(3, 3, 20, 30)
    relevancy[:, :, 0:4] = relevancy[:, :, 10:15] = 1
    apart, together = (
        threed_ovs.PROTOCOL.score_frame(frame, relevancy)[1].iou for frame in (frames[0], first)
    )
    assert together > 0.8 > 0.6 > apart


def test_a_frame_without_a_class_is_told_and_not_scored(tmp_path: Path) -> None:
    write_scene(tmp_path)
    (tmp_path / "segmentations" / "02" / "lamp.png").unlink()
    with warns(ScoupWarning):
        frames = threed_ovs.read_segmentations(tmp_path)
    assert [len(frame.labels) for frame in frames] == [3, 2]


def square(*rows: int) -> torch.Tensor:
    maps = torch.zeros(20, 30)
    maps[rows[0] : rows[1], 8:20] = 1
    return maps


def frame_of(mask: torch.Tensor) -> LabelledFrame:
    return LabelledFrame("00", 30, 20, {"lamp": mask > 0}, {})


def test_the_fine_level_has_no_say() -> None:
    maps = torch.stack([square(0, 6) * 5, square(7, 14) * 0.5, square(14, 20) * 0.4])
    (pair,) = threed_ovs.PROTOCOL.score_frame(frame_of(square(7, 14)), maps[:, None])
    assert pair.level == 1
    assert pair.iou > 0.7
    for levels in (("s", "x", "l"), ("m", "l")):
        with refuses():
            threed_ovs.PROTOCOL.score_frame(frame_of(square(0, 6)), maps[:, None], levels=levels)


def test_the_level_with_the_highest_mean_inside_its_mask_answers_not_the_highest_peak() -> None:
    spread = square(7, 14) * 0.4
    spread[10, 14] = 0.6  # the highest peak, in a mask of low mean
    even = square(0, 6) * 0.5
    maps = torch.stack([even, spread, even])
    (pair,) = threed_ovs.PROTOCOL.score_frame(frame_of(square(0, 6)), maps[:, None])
    assert pair.level == 2


def test_empty_masks() -> None:
    nothing = torch.zeros(20, 30)
    flat = torch.full((3, 1, 20, 30), 0.5)
    (pair,) = threed_ovs.PROTOCOL.score_frame(frame_of(square(0, 6)), flat)
    assert (pair.iou, pair.level) == (0.0, 1)  # nothing predicted, something there
    (pair,) = threed_ovs.PROTOCOL.score_frame(frame_of(nothing), flat)
    assert pair.iou == 1.0  # nothing predicted, nothing there
    (pair,) = threed_ovs.PROTOCOL.score_frame(frame_of(nothing), torch.stack([square(0, 6)] * 3)[:, None])
    assert pair.iou == 0.0


def test_scene_score_is_the_mean_over_frames_and_classes(tmp_path: Path) -> None:
    frames = threed_ovs.read_segmentations(write_scene(tmp_path))
    maps = [torch.rand(3, 3, 20, 30, generator=torch.Generator().manual_seed(seed)) for seed in (0, 1)]
    scene = threed_ovs.PROTOCOL.score("sofa", zip(frames, maps, strict=True))
    assert len(scene.pairs) == 6
    assert scene.miou == pytest.approx(sum(pair.iou for pair in scene.pairs) / 6)
    assert overall([scene]) == (scene.miou, None)
    with refuses():
        _ = scene.accuracy


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no classes": lambda home: (home / "classes.txt").unlink(),
    "empty": lambda home: (home / "classes.txt").write_text("\n \n"),
    "twice": lambda home: (home / "classes.txt").write_text("lamp\nlamp\n"),
    "no text": lambda home: (home / "classes.txt").write_bytes(b"\xff\xfe\x00lamp"),
    "picture": lambda home: (home / "00" / "lamp.png").write_bytes(b"no picture"),
    "sizes": lambda home: paint(home / "00" / "lamp.png", size=(20, 31)),
    "none": lambda home: (home / "classes.txt").write_text("unheard of\n"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_told(tmp_path: Path, damage: str) -> None:
    with refuses(MissingFileError):
        threed_ovs.read_segmentations(tmp_path / "absent")
    DAMAGES[damage](write_scene(tmp_path) / "segmentations")
    with refuses(FileFormatError):
        threed_ovs.read_segmentations(tmp_path)
