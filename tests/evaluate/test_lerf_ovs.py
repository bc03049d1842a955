"""The LERF-OVS protocol: reading labels, matching frames, scoring by hand."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

from messages import refuses, warns
from scoup.base import FileFormatError, MissingFileError, ScoupWarning
from scoup.scene import Camera, Cameras
from scoup_lab.data.labels import match_frames, read_frame, read_labels
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.scores import overall


def square(label: str, x1: float, y1: float, x2: float, y2: float) -> dict:
    polygon = [[x1, y1], [x2, y1], [x2, y2], [x1, y2]]
    return {
        "category": label, "group": 1, "segmentation": polygon, "area": 1.0, "layer": 1.0,
        "bbox": [x1, y1, x2, y2], "iscrowd": False, "note": "",
    }  # fmt: skip


def write_label(path: Path, objects: list[dict], width: int = 60, height: int = 40) -> Path:
    info = {"name": path.with_suffix(".jpg").name, "width": width, "height": height, "depth": 3, "note": ""}
    path.write_text(json.dumps({"info": info, "objects": objects}))
    return path


def test_polygons_are_cut_to_whole_pixels_filled_and_united(tmp_path: Path) -> None:
    path = write_label(
        tmp_path / "frame_00041.json",
        [square("cup", 10.4, 5.6, 19.6, 9.4), square("pot", 0, 0, 59, 39), square("cup", 30, 20, 34, 22)],
    )
    frame = read_frame(path)
    assert (frame.name, frame.width, frame.height, frame.labels) == ("frame_00041", 60, 40, ("cup", "pot"))
    expected = torch.zeros(40, 60, dtype=torch.bool)
    expected[5:10, 10:20] = True  # int32 of 10.4, 5.6, 19.6, 9.4; whole pixels towards zero
    expected[20:23, 30:35] = True
    assert frame.masks["cup"].equal(expected)
    assert frame.masks["pot"].all()
    assert frame.boxes["cup"].shape == (2, 4)
    assert frame.boxes["cup"][1].tolist() == [30, 20, 34, 22]


def test_polygons_are_painted_as_opencv_paints_them(tmp_path: Path) -> None:
    """Rows of ``cv2.fillPoly`` for this triangle: the pixels that its edges cross are inside."""
    triangle = square("cup", 0, 0, 20, 20)
    triangle["segmentation"] = [[2.9, 2.0], [15.0, 5.7], [9.4, 17.0]]
    (mask,) = read_frame(write_label(tmp_path / "a.json", [triangle])).masks.values()
    spans = [(2, 4), (2, 8), (3, 12), (3, 15), (4, 14), (4, 14), (5, 13), (5, 13), (6, 12)]  # from row 2 on
    spans += [(6, 12), (7, 11), (7, 11), (8, 10), (8, 10), (9, 9), (9, 9)]
    expected = torch.zeros(40, 60, dtype=torch.bool)
    for row, (first, last) in enumerate(spans, 2):
        expected[row, first : last + 1] = True
    assert mask.equal(expected)


def test_odd_polygons(tmp_path: Path) -> None:
    point, line = square("point", 3, 4, 3, 4), square("line", 0, 0, 5, 0)
    point["segmentation"] = [[3, 4]]
    line["segmentation"] = [[0, 0], [5, 0]]
    outside = square("outside", -50, -50, 500, 5)
    del outside["bbox"]
    frame = read_frame(write_label(tmp_path / "a.json", [point, line, outside]))
    assert frame.masks["point"].nonzero().tolist() == [[4, 3]]
    assert frame.masks["line"].nonzero().tolist() == [[0, x] for x in range(6)]
    assert frame.masks["outside"].equal((torch.arange(40) <= 5)[:, None].expand(40, 60))
    assert frame.boxes["outside"].tolist() == [[-50, -50, 500, 5]]


def test_other_render_size(tmp_path: Path) -> None:
    frame = read_frame(write_label(tmp_path / "f.json", [square("cup", 20, 10, 39, 29)]))
    relevancy = torch.zeros(1, 1, 80, 120)
    relevancy[0, 0, 20:60, 40:80] = 1
    (pair,) = PROTOCOL.score_frame(frame, relevancy)
    assert pair.hit
    assert 0.85 < pair.iou < 38**2 / 40**2
    small = frame.resized(30, 20)
    assert small.masks["cup"].nonzero().min(0).values.tolist() == [5, 10]
    assert small.masks["cup"].sum() == 100
    assert small.boxes["cup"].tolist() == [[9.75, 4.75, 19.25, 14.25]]


def test_scene_scores(tmp_path: Path) -> None:
    cup = square("cup", 20, 10, 39, 29)
    objects = {"a": [cup, square("cup", 0, 0, 3, 3)], "b": [cup, square("pot", 0, 0, 9, 9)]}
    frames = [read_frame(write_label(tmp_path / f"{name}.json", of)) for name, of in objects.items()]
    maps = torch.zeros(1, 40, 60)
    maps[0, 10:30, 20:40] = 1
    both = torch.stack([maps, maps], 1)
    scene = PROTOCOL.score("kitchen", ((frame, both[:, : len(frame.labels)]) for frame in frames))
    assert [(pair.frame, pair.label, pair.hit) for pair in scene.pairs] == [
        ("a", "cup", True), ("b", "cup", True), ("b", "pot", False),
    ]  # fmt: skip
    assert scene.accuracy == pytest.approx(2 / 3)
    assert scene.miou == pytest.approx(sum(pair.iou for pair in scene.pairs) / 3)
    other = PROTOCOL.score("other", [(frames[0], maps[None])])
    assert overall([scene, other])[1] == pytest.approx((2 / 3 + 1) / 2)
    for wrong in (maps[None], torch.zeros(1, 3, 40, 60), maps):
        with refuses():
            PROTOCOL.score_frame(frames[1], wrong)
    for nothing in (lambda: PROTOCOL.score("none", []), lambda: overall([])):
        with refuses():
            nothing()


def cameras(*names: str) -> Cameras:
    return Cameras(Camera(name, torch.eye(4), torch.eye(3), 60, 40) for name in names)


def test_frames_are_matched_by_name(tmp_path: Path) -> None:
    # frame_00002 failed to register: by number, frame_00003 would be scored against the wrong view
    for number in (1, 3):
        write_label(tmp_path / f"frame_{number:05}.json", [square("cup", 1, 1, 5, 5)])
    frames = read_labels(tmp_path)
    matched = match_frames(frames, cameras("frame_00001.jpg", "frame_00003.jpg", "frame_00004.jpg"))
    assert [camera.name for _, camera in matched] == ["frame_00001.jpg", "frame_00003.jpg"]
    with warns(ScoupWarning):
        assert len(match_frames(frames, cameras("frame_00001.jpg"))) == 1
    with refuses():
        match_frames(frames, cameras("DSC01.jpg"))


def test_missing_labels(tmp_path: Path) -> None:
    for read, path in (
        (read_labels, tmp_path),
        (read_labels, tmp_path / "absent"),
        (read_frame, tmp_path / "a.json"),
    ):
        with pytest.raises(MissingFileError):
            read(path)


GOOD = {"info": {"width": 60, "height": 40}, "objects": [square("cup", 1, 1, 5, 5)]}


@pytest.mark.parametrize(
    "content",
    [
        "", "[]", "{", "null", '{"info": {"width": 4, "height": 4}}', '{"info": [], "objects": []}',
        *[json.dumps({**GOOD, "info": info}) for info in (
            {}, {"width": 0, "height": 4}, {"width": "60", "height": 40}, {"width": 1e9, "height": 1e9},
            {"width": 99999, "height": 99999})],
        *[json.dumps({**GOOD, "objects": [{**GOOD["objects"][0], **change}]}) for change in (
            {"category": None}, {"category": " "}, {"segmentation": []}, {"segmentation": None},
            {"segmentation": [[1]]}, {"segmentation": [[1, "2"]]}, {"segmentation": [[1, float("nan")]]},
            {"segmentation": [[1e300, 2]]}, {"bbox": [1, 2, 3]}, {"bbox": "1234"})],
        json.dumps({**GOOD, "objects": [7]}),
    ],
)  # fmt: skip
def test_bad_label_files(tmp_path: Path, content: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(content)
    with refuses(FileFormatError):
        read_frame(path)


@pytest.mark.data
def test_kitchen_labels(data_folder: Path) -> None:
    folder = data_folder / "kitchen" / "label"
    if not folder.is_dir():
        pytest.skip(f"no kitchen labels at {folder}")
    frames = read_labels(folder)
    assert len(frames) == 6
    assert all((frame.width, frame.height) == (960, 720) for frame in frames)
    # The truth itself as relevancy: only what the protocol shaves off the edges is lost.
    pairs = PROTOCOL.score_frame(frames[0], torch.stack([*frames[0].masks.values()]).float()[None])
    assert all(pair.hit for pair in pairs)
    assert sum(pair.iou for pair in pairs) / len(pairs) > 0.8


@pytest.mark.parametrize("label", ["cup", None])
def test_masks_of_no_end_are_refused(tmp_path: Path, label: str | None) -> None:
    """A few bytes an object ask for a mask of all pixels, or for painting all of them again."""
    count = 400 if label else 20
    objects = [square(label or f"thing {number}", 0, 0, 9, 9) for number in range(count)]
    path = write_label(tmp_path / "f.json", objects, 5000, 5000)
    with refuses(FileFormatError):
        read_frame(path)
    few = read_frame(write_label(tmp_path / "g.json", objects[:8], 5000, 5000))
    assert len(few.masks) == (1 if label else 8)
