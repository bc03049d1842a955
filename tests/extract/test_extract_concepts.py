"""Words looked for in photographs at extraction: stored per photograph, resumed, and used by a build."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from mask_samples import smooth_image
from messages import refuses
from scoup.base import FileFormatError
from scoup.extract import find_photographs
from scoup.extract.concepts import boxes_as_stored, extract_concepts
from scoup.extract.photographs import Pixels
from scoup.io.detections import DetectionStore
from scoup.scene import Detections


class Corner:
    """A model that sees its first text in the upper left corner of any photograph."""

    def __init__(self, version: int = 1) -> None:
        self.version, self.calls = version, 0

    def to_dict(self) -> dict[str, int]:
        return {"corner": self.version}

    def detect(self, image: np.ndarray, texts: Sequence[str]) -> Detections:
        self.calls += 1
        height, width = image.shape[:2]
        box = torch.tensor([[0.0, 0.0, width / 2, height / 4]])
        return Detections(torch.zeros(1, dtype=torch.int64), torch.tensor([0.5]), box, (width, height))


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    folder = tmp_path / "photographs"
    (folder / "cam").mkdir(parents=True)
    for number, name in enumerate(("0.png", "cam/0.png")):
        Image.fromarray(smooth_image(20, 30, number)).save(folder / name)
    return folder


def test_detections_are_stored_and_resumed(photographs: Path, tmp_path: Path) -> None:
    found, folder, model = find_photographs(photographs), tmp_path / "concepts", Corner()
    report = extract_concepts(found, folder, model, ["mug", "cup", "mug"])
    assert (report.made, report.kept, model.calls) == (["0.png", "cam/0.png"], 0, 2)
    store = DetectionStore.open(folder)
    assert (store.texts, store.settings) == (("mug", "cup"), {"corner": 1, "max_height": 1080})
    read = store.read("cam/0.png")
    assert read is not None
    assert (read.texts.tolist(), read.scores.tolist(), read.boxes.tolist()) == ([0], [0.5], [[0, 0, 15, 5]])
    assert (read.size, store.read("2.png")) == ((30, 20), None)
    Image.fromarray(smooth_image(20, 30, 9)).save(photographs / "0.png")
    assert extract_concepts(found, folder, model, ["mug", "cup"]).made == ["0.png"], "it has changed"
    for other in ((Corner(2), ["mug", "cup"]), (Corner(), ["mug"])):
        with refuses():
            extract_concepts(found, folder, *other)
    assert len(extract_concepts(found, folder, Corner(2), ["pen"], overwrite=True).made) == 2
    with refuses():
        extract_concepts(found, folder, model, [])


def test_damaged_detections_are_refused(photographs: Path, tmp_path: Path) -> None:
    folder = tmp_path / "concepts"
    extract_concepts(find_photographs(photographs), folder, Corner(), ["mug", "cup"])
    record = json.loads((folder / "0.json").read_text())
    for change, said in (
        ({"detections": [[2, 0.5, 0, 0, 1, 1]]}, "of unknown texts"),
        ({"detections": [[0, 0.5, 0, 0]]}, "contains no detections"),  # and what torch says
        ({"detections": [["a"] * 6]}, "contains no detections"),
        ({"size": [0, 5]}, "0 x 5 pixels"),
        ({"size": 5}, "contains no detections"),
    ):
        (folder / "0.json").write_text(json.dumps({**record, **change}))
        with pytest.raises(FileFormatError, match=said):
            DetectionStore.open(folder).read("0.png")


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("turns", range(4))
def test_boxes_turn_with_their_photograph(turns: int, mirrored: bool) -> None:
    upright = np.zeros((20, 30), np.int32)
    upright[2:7, 4:16] = 1
    pixels = Pixels(np.zeros((20, 30, 3), np.uint8), turns, mirrored, "")
    stored = pixels.as_stored(upright)
    rows, columns = (np.flatnonzero(stored.any(axis)) for axis in (1, 0))
    wanted = [columns[0], rows[0], columns[-1] + 1, rows[-1] + 1]
    assert boxes_as_stored(pixels, torch.tensor([[4.0, 2, 16, 7]])).tolist() == [wanted]
