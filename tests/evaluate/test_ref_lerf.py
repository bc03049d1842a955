"""Ref-LERF: sentences and masks of the test frames, what is scored, and files that are none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
import torch

from scoup.base.errors import FileFormatError, InputError, MissingFileError
from scoup.io import save_png
from scoup_lab.evaluate.protocols import ref_lerf

SIZE = (20, 30)


def rows(first: int, last: int) -> torch.Tensor:
    mask = torch.zeros(SIZE, dtype=torch.uint8)
    mask[first:last] = 1  # as dark as an inside pixel may be
    return mask


def put(folder: Path, frame: str, home: str = "json", objects: list[Any] | None = None) -> Path:
    """A frame with a cup, a plate that one sentence shares with it, and a thing out of sight."""
    given = [
        {"category": "cup", "segmentation": f"{frame}/cup.png", "sentence": ["the cup", "what holds tea"]},
        {"category": "plate", "segmentation": f"{frame}/plate.png", "sentence": ["the plate", "the cup"]},
        {"category": "bin", "segmentation": f"{frame}/bin.png", "sentence": ["the bin"]},
    ]
    place = folder / home / f"{frame}.json"
    place.parent.mkdir(parents=True, exist_ok=True)
    place.write_text(json.dumps({"object": given if objects is None else objects}))
    for name, mask in (("cup", rows(0, 5)), ("plate", rows(10, 12)), ("bin", rows(0, 0))):
        save_png(mask, folder / "gt_mask" / frame / f"{name}.png", overwrite=True)
    return folder


def test_sentences_and_masks(tmp_path: Path) -> None:
    (frame,) = ref_lerf.read_frames(put(tmp_path, "frame_00003"))
    assert (frame.name, frame.width, frame.height) == ("frame_00003", 30, 20)
    assert frame.labels == ("the cup", "what holds tea", "the plate")  # the bin's mask is empty
    assert frame.masks["what holds tea"].any(1).nonzero().flatten().tolist() == [0, 1, 2, 3, 4]
    assert frame.masks["the cup"].equal((rows(0, 5) | rows(10, 12)).bool())  # it refers to two things


def test_test_frames(tmp_path: Path) -> None:
    other, ramen, split = tmp_path / "kitchen_of_mine", tmp_path / "ramen", tmp_path / "split" / "ramen"
    for folder in (other, ramen):
        for number in (5, 6, 24, 128):
            put(folder, f"frame_{number:05d}")
    assert len(ref_lerf.read_frames(other)) == 4
    assert [frame.name for frame in ref_lerf.read_frames(ramen)] == [
        "frame_00006",
        "frame_00024",
        "frame_00128",
    ]
    put(split, "frame_00006", "json/train_json")
    put(split, "frame_00005", "json/test_json")
    assert [frame.name for frame in ref_lerf.read_frames(split)] == ["frame_00005"]
    assert ref_lerf.sentence_folder(tmp_path / "none") == tmp_path / "none" / "json"
    # As published.
    assert {name: len(frames) for name, frames in ref_lerf.TEST_FRAMES.items()} == {
        "ramen": 7,
        "figurines": 4,
        "teatime": 6,
        "waldo_kitchen": 5,
    }
    assert ref_lerf.TEST_FRAMES["waldo_kitchen"] == (19, 35, 67, 105, 162)


def test_scores_by_hand(tmp_path: Path) -> None:
    (frame,) = ref_lerf.read_frames(put(tmp_path, "frame_00003"))
    maps = torch.zeros(3, 3, *SIZE)
    maps[1, 0] = frame.masks["the cup"]
    maps[1, 1] = frame.masks["what holds tea"]
    maps[1, 2, 10:12] = 1
    right = ref_lerf.PROTOCOL.score("s", [(frame, maps)])
    assert right.protocol == "ref-lerf 2D"
    assert not right.localizes
    assert [pair.label for pair in right.pairs] == list(frame.labels)
    assert all(pair.level == 1 for pair in right.pairs)
    assert right.pairs[1].iou > 0.75  # but for what the box means take away
    wrong = ref_lerf.PROTOCOL.score("s", [(frame, maps.flip(1))])
    assert wrong.pairs[1].iou == right.pairs[1].iou  # the middle one stays in its place
    assert (wrong.pairs[0].iou, right.pairs[0].iou > 0.5) == (0, True)


def test_a_sentence_without_a_map_is_refused(tmp_path: Path) -> None:
    (frame,) = ref_lerf.read_frames(put(tmp_path, "frame_00003"))
    with pytest.raises(InputError, match="no relevancy map for the label 'the plate'"):
        ref_lerf.PROTOCOL.score_frame(frame, {label: torch.rand(3, *SIZE) for label in frame.labels[:2]})


@pytest.mark.parametrize(
    ("item", "problem"),
    [
        ("cup", r"object\[0\] is 'cup', expected an object"),
        ({"sentence": ["x"]}, r"object\[0\]\.segmentation is missing"),
        ({"segmentation": "frame_00003/cup.png"}, r"object\[0\]\.sentence is missing, expected a list"),
        ({"segmentation": "frame_00003/cup.png", "sentence": "the cup"}, "expected a list"),
        ({"segmentation": "frame_00003/cup.png", "sentence": [" "]}, "expected a text"),
        ({"segmentation": "../../secret.png", "sentence": ["x"]}, "expected a mask in gt_mask"),
        (
            {"segmentation": "frame_00003/absent.png", "sentence": ["x"]},
            r"absent\.png: there is no such file",
        ),
    ],
)
def test_damaged_sentences_are_refused(tmp_path: Path, item: Any, problem: str) -> None:
    put(tmp_path, "frame_00003", objects=[item])
    with pytest.raises(FileFormatError, match=problem):
        ref_lerf.read_frames(tmp_path)


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(MissingFileError, match="expected sentences"):
        ref_lerf.read_frames(tmp_path)
    put(tmp_path, "frame_00003")
    save_png(torch.ones(5, 5, dtype=torch.uint8), tmp_path / "gt_mask/frame_00003/plate.png", overwrite=True)
    with pytest.raises(FileFormatError, match="differ in size"):
        ref_lerf.read_frames(tmp_path)
    (tmp_path / "gt_mask/frame_00003/plate.png").write_bytes(b"no picture")
    with pytest.raises(FileFormatError, match="not an image"):
        ref_lerf.read_frames(tmp_path)
    (tmp_path / "json/frame_00003.json").write_text("[]")
    with pytest.raises(FileFormatError, match="its content is a list of 0, expected an object"):
        ref_lerf.read_frames(tmp_path)
    (tmp_path / "json/frame_00003.json").rename(tmp_path / "json/frame_00003.txt")
    with pytest.raises(MissingFileError, match="contains no sentences"):
        ref_lerf.read_frames(tmp_path)
