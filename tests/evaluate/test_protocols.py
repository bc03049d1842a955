"""The 2D protocols and 3D selection: reading labels and painted masks, matching frames, scoring by hand."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor

from messages import refuses, warns
from scoup import raster
from scoup.base import FileFormatError, MissingFileError, ScoupWarning
from scoup.io import save_png
from scoup.scene import Camera, Cameras, Gaussians
from scoup_lab.data.labels import LabelledFrame, match_frames, read_frame, read_labels
from scoup_lab.evaluate.protocols import lerf_ovs, threed_ovs
from scoup_lab.evaluate.protocols.lerf_ovs import PROTOCOL
from scoup_lab.evaluate.protocols.pixels import PixelProtocol
from scoup_lab.evaluate.protocols.selection import NEIGHBOURS, OPAQUE, THRESHOLD, score_scene, silhouette
from scoup_lab.evaluate.scores import SceneScore, overall
from support import gaussians_at, make_camera, random_gaussians
from uplift.edits import joined


def scored(protocol: PixelProtocol, name: str, frames: Iterable[tuple[LabelledFrame, Tensor]]) -> SceneScore:
    pairs = [pair for frame, maps in frames for pair in protocol.score_frame(frame, maps)]
    return SceneScore(name, protocol.rule().name, tuple(pairs), protocol.title)


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
    cups = square("cup", 10.4, 5.6, 19.6, 9.4), square("cup", 30, 20, 34, 22)
    frame = read_frame(
        write_label(tmp_path / "frame_00041.json", [cups[0], square("pot", 0, 0, 59, 39), cups[1]])
    )
    assert (frame.name, frame.width, frame.height, frame.labels) == ("frame_00041", 60, 40, ("cup", "pot"))
    expected = torch.zeros(40, 60, dtype=torch.bool)
    expected[5:10, 10:20] = True  # int32 of 10.4, 5.6, 19.6, 9.4; whole pixels towards zero
    expected[20:23, 30:35] = True
    assert frame.masks["cup"].equal(expected)
    assert frame.masks["pot"].all()
    assert frame.boxes["cup"].equal(torch.tensor([[10.4, 5.6, 19.6, 9.4], [30, 20, 34, 22]]))


def test_odd_polygons_are_painted_as_opencv_paints_them(tmp_path: Path) -> None:
    """The triangle has the rows of ``cv2.fillPoly``: the pixels that its edges cross are inside."""
    point = {**square("point", 3, 4, 3, 4), "segmentation": [[3, 4]]}
    line = {**square("line", 0, 0, 5, 0), "segmentation": [[0, 0], [5, 0]]}
    triangle = {**square("triangle", 0, 0, 20, 20), "segmentation": [[2.9, 2.0], [15.0, 5.7], [9.4, 17.0]]}
    outside = square("outside", -50, -50, 500, 5)
    del outside["bbox"]
    frame = read_frame(write_label(tmp_path / "a.json", [point, line, triangle, outside]))
    spans = [(2, 4), (2, 8), (3, 12), (3, 15), (4, 14), (4, 14), (5, 13), (5, 13), (6, 12)]  # from row 2 on
    spans += [(6, 12), (7, 11), (7, 11), (8, 10), (8, 10), (9, 9), (9, 9)]
    assert frame.masks["triangle"].nonzero().tolist() == [
        [row, x] for row, (first, last) in enumerate(spans, 2) for x in range(first, last + 1)
    ]
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
    scene = scored(PROTOCOL, "kitchen", ((frame, both[:, : len(frame.labels)]) for frame in frames))
    assert [(pair.frame, pair.label, pair.hit) for pair in scene.pairs] == [
        ("a", "cup", True), ("b", "cup", True), ("b", "pot", False),
    ]  # fmt: skip
    assert scene.accuracy == pytest.approx(2 / 3)
    assert scene.miou == pytest.approx(sum(pair.iou for pair in scene.pairs) / 3)
    other = scored(PROTOCOL, "other", [(frames[0], maps[None])])
    assert overall([scene, other])[1] == pytest.approx((2 / 3 + 1) / 2)
    for wrong in (maps[None], torch.zeros(1, 3, 40, 60), maps):
        with refuses():
            PROTOCOL.score_frame(frames[1], wrong)
    for nothing in (lambda: scored(PROTOCOL, "none", []), lambda: overall([])):
        with refuses():
            nothing()


def test_frames_are_matched_by_name(tmp_path: Path) -> None:
    # frame_00002 failed to register: by number, frame_00003 would be scored against the wrong view
    for number in (1, 3):
        write_label(tmp_path / f"frame_{number:05}.json", [square("cup", 1, 1, 5, 5)])
    frames = read_labels(tmp_path)

    def cameras(*names: str) -> Cameras:
        return Cameras(Camera(name, torch.eye(4), torch.eye(3), 60, 40) for name in names)

    matched = match_frames(frames, cameras("frame_00001.jpg", "frame_00003.jpg", "frame_00004.jpg"))
    assert [camera.name for _, camera in matched] == ["frame_00001.jpg", "frame_00003.jpg"]
    with warns(ScoupWarning):
        assert len(match_frames(frames, cameras("frame_00001.jpg"))) == 1
    with refuses():
        match_frames(frames, cameras("DSC01.jpg"))
    for width, height in ((120, 80), (45, 30), (61, 40)):  # other sizes of this shape, rounded
        assert match_frames(
            frames[:1], Cameras([Camera("frame_00001", torch.eye(4), torch.eye(3), width, height)])
        )
    with refuses():
        match_frames(frames[:1], Cameras([Camera("frame_00001", torch.eye(4), torch.eye(3), 40, 60)]))
    absent, empty = tmp_path / "absent", tmp_path / "empty"
    empty.mkdir()
    for read, path in ((read_labels, empty), (read_labels, absent), (read_frame, tmp_path / "a.json")):
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
            {"segmentation": [[70, 2], [80, 2]]}, {"segmentation": [[1]]}, {"segmentation": [[1, "2"]]},
            {"segmentation": [[1, float("nan")]]},
            {"segmentation": [[1e300, 2]]}, {"bbox": [1, 2, 3]}, {"bbox": "1234"})],
        json.dumps({**GOOD, "objects": [7]}),
    ],
)  # fmt: skip
def test_bad_label_files(tmp_path: Path, content: str) -> None:
    path = tmp_path / "bad.json"
    path.write_text(content)
    with refuses(FileFormatError):
        read_frame(path)


@pytest.mark.parametrize("label", ["cup", None])
def test_masks_of_no_end_are_refused(tmp_path: Path, label: str | None) -> None:
    """A few bytes an object ask for a mask of all pixels, or for painting all of them again."""
    count = 400 if label else 20
    objects = [square(label or f"thing {number}", 0, 0, 9, 9) for number in range(count)]
    path = write_label(tmp_path / "f.json", objects, 5000, 5000)
    with refuses(FileFormatError):
        read_frame(path)
    few = read_frame(write_label(tmp_path / "g.json", objects[:20], 988, 731))  # as large as published ones
    assert len(few.masks) == (1 if label else 20)


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
        paint(home / frame / "lamp.png", 17, 19)
    (home / "classes.txt").write_text("lamp\nwood wall\n\nwood table \n")
    return folder


def test_reading(tmp_path: Path) -> None:
    frames = threed_ovs.read_segmentations(write_scene(tmp_path))
    assert [frame.name for frame in frames] == ["00", "02"]
    assert frames[0].labels == ("lamp", "wood wall", "wood table")
    assert (frames[0].width, frames[0].height) == (30, 20)
    assert frames[0].masks["wood wall"].any(1).nonzero().flatten().tolist() == [10, 11, 12, 13, 14]
    assert int(frames[0].masks["lamp"].sum()) == 60
    # Anything brighter than half is inside, whatever the mode.
    picture = Image.fromarray(np.full((20, 30, 3), 255, np.uint8))
    picture.putpixel((5, 6), (20, 20, 20))
    picture.save(tmp_path / "segmentations" / "00" / "lamp.png")
    mask = threed_ovs.read_segmentations(tmp_path)[0].masks["lamp"]
    assert (~mask).nonzero().tolist() == [[6, 5]]
    # A frame without a class is told, and not scored.
    (tmp_path / "segmentations" / "02" / "lamp.png").unlink()
    with warns(ScoupWarning):
        frames = threed_ovs.read_segmentations(tmp_path)
    assert [len(frame.labels) for frame in frames] == [3, 2]


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


def test_empty_masks() -> None:
    flat, spot = torch.full((3, 1, 20, 30), 0.5), torch.zeros(3, 1, 20, 30)
    spot[..., :6, 8:20] = 1
    for maps, truth, expected in ((flat, spot, 0), (flat, 0 * spot, 1), (spot, 0 * spot, 0)):
        frame = LabelledFrame("00", 30, 20, {"lamp": truth[0, 0] > 0}, {})
        (pair,) = threed_ovs.PROTOCOL.score_frame(frame, maps)
        assert (pair.iou, pair.level) == (expected, 1)
    scene = scored(threed_ovs.PROTOCOL, "sofa", [(frame, flat)])
    assert overall([scene]) == (scene.miou, None)
    with refuses():
        _ = scene.accuracy
    for levels in (("s", "x", "l"), ("m", "l")):
        with refuses():
            threed_ovs.PROTOCOL.score_frame(frame, flat, levels=levels)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "no classes": lambda home: (home / "classes.txt").unlink(),
    "empty": lambda home: (home / "classes.txt").write_text("\n \n"),
    "twice": lambda home: (home / "classes.txt").write_text("lamp\nlamp\n"),
    "no text": lambda home: (home / "classes.txt").write_bytes(b"\xff\xfe\x00lamp"),
    "picture": lambda home: (home / "00" / "lamp.png").write_bytes(b"no picture"),
    "sizes": lambda home: paint(home / "00" / "lamp.png", 1, 2, size=(20, 31)),
    "black": lambda home: paint(home / "00" / "lamp.png"),
    "none": lambda home: (home / "classes.txt").write_text("unheard of\n"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_damage_is_told(tmp_path: Path, damage: str) -> None:
    with refuses(MissingFileError):
        threed_ovs.read_segmentations(tmp_path / "absent")
    DAMAGES[damage](write_scene(tmp_path) / "segmentations")
    with refuses(FileFormatError):
        threed_ovs.read_segmentations(tmp_path)


def blob(x: float, z: float, opacity: float = 0.99) -> Gaussians:
    return gaussians_at(torch.tensor([[x, 0.0, z]]), 0.2, opacity)


def test_what_hides_a_thing_does_not_hide_its_silhouette() -> None:
    scene, camera = joined(blob(0, 2), blob(0, 4)), make_camera()
    behind = silhouette(scene, torch.tensor([False, True]), camera, "inria")
    alone = silhouette(blob(0, 4), torch.tensor([True]), camera, "inria")
    assert behind.equal(alone)
    assert alone.any()
    assert not silhouette(scene, torch.tensor([False, False]), camera, "inria").any()


def test_silhouettes_begin_at_their_opacity() -> None:
    camera = make_camera()
    faint = blob(0, 3, 0.03)  # under 10 / 255
    assert not silhouette(faint, torch.tensor([True]), camera, "inria").any()
    scene = random_gaussians(40, 3)
    chosen = torch.arange(40) % 2 == 0
    projection = raster.project(scene.select(chosen), camera, "inria")
    alpha = raster.render_channels(projection, torch.ones(20, 1))[0][..., 0]
    expected = alpha > 10 / 255
    assert silhouette(scene, chosen, camera, "inria").equal(expected)
    assert (NEIGHBOURS, THRESHOLD, OPAQUE) == (10, 0.6, 10 / 255)


def test_scores() -> None:
    scene, camera = joined(blob(-0.6, 3), blob(0.6, 3)), make_camera(name="a.png")
    left, right = torch.tensor([True, False]), torch.tensor([False, True])
    truth = silhouette(scene, left, camera, "inria")
    nothing = torch.zeros_like(truth)
    frame = LabelledFrame("a", 40, 30, {"cup": truth, "pot": truth, "none": nothing}, {})
    chosen = {"cup": left, "pot": right, "none": torch.zeros(2, dtype=torch.bool)}
    score = score_scene("s", scene, [(frame, camera)], chosen)
    # A selection that shows nothing scores 0, even where the truth is empty.
    assert [pair.iou for pair in score.pairs] == [1.0, pytest.approx(0.0, abs=0.05), 0.0]
    assert score.protocol == "3D selection"
    with refuses():
        score_scene("s", scene, [(frame, camera)], {"cup": left})
    boxed = LabelledFrame("a", 40, 30, {"cup": truth}, {"cup": torch.zeros(1, 4)})
    with refuses():  # scores of two protocols are never averaged together
        overall([score, scored(lerf_ovs.PROTOCOL, "s", [(boxed, torch.rand(3, 1, 30, 40))])])
