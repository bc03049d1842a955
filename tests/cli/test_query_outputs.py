"""scoup query: arrays, COCO, videos and places, and the same from Python."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from cli_support import run, run_json
from scoup.query import LanguageField

pytestmark = pytest.mark.usefixtures("here")
TEXTS = ("kettle", "mug")


def test_arrays_and_coco_hold_the_answers():
    options = ("--camera", "all", "--npz", "--coco", "--pictures", "none", "--out", "a")
    record = run_json("query", "f.scoup", *TEXTS, *options)
    assert record["sheets"] == []
    field = LanguageField.load("f.scoup")
    coco = json.loads(Path("a/coco.json").read_text())
    assert field.cameras is not None
    assert [image["file_name"] for image in coco["images"]] == list(field.cameras.names)
    areas = {(one["image_id"], one["category_id"]): one["area"] for one in coco["annotations"]}
    for number, camera in enumerate(field.cameras):
        answers = field.at(camera).answer(list(TEXTS))
        with np.load(f"a/{camera.stem}/relevancy.npz", allow_pickle=False) as arrays:
            assert arrays["texts"].tolist() == list(TEXTS)
            assert arrays["levels"].tolist() == [answer.level for answer in answers]
            assert arrays["relevancy"].dtype == np.float32
            for row, answer in enumerate(answers):
                assert np.array_equal(arrays["relevancy"][row], answer.heat.numpy())
                assert np.array_equal(arrays["mask"][row], answer.mask.numpy())
                assert arrays["present"][row] == answer.presence
                assert np.isnan(arrays["score"][row])  # too few words to judge presence
                assert areas.get((number + 1, row + 1), 0) == int(answer.mask.sum())
        entry = record["answers"][2 * number]
        assert entry["files"] == {"npz": f"a/{camera.stem}/relevancy.npz"}
    again = run_json("query", "f.scoup", *TEXTS, "--camera", "view_00", "--npz", "--out", "b")
    assert again["answers"][0]["files"]["npz"] == "b/view_00/relevancy.npz"
    assert Path("a/view_00/relevancy.npz").read_bytes() == Path("b/view_00/relevancy.npz").read_bytes()


def test_python_says_what_the_command_line_says():
    record = run_json("query", "f.scoup", *TEXTS, "--camera", "all", "--pictures", "none", "--out", "a")
    field = LanguageField.load("f.scoup")
    for number, (answer, place) in enumerate(
        zip(field.answer(list(TEXTS)), field.location(list(TEXTS)), strict=True)
    ):
        assert answer.text == TEXTS[number]
        assert {"text": answer.text, **place.to_dict()} == record["places"][number]
        assert field.location(answer).to_dict() == field.location(answer.text).to_dict() == place.to_dict()
        entries = [entry for entry in record["answers"] if entry["text"] == answer.text]
        for camera, entry in zip(field.cameras or (), entries, strict=True):
            seen = field.at(camera).show([answer])[0]
            assert {"camera": seen.view, "text": seen.text, **seen.to_dict()} == entry
            assert (seen.position is None) == (entry["position"] is None)


def test_places_in_metres():
    record = run_json("query", "f.scoup", "kettle", "--out", "a", "--metres-per-unit", "0.5")
    (place,) = record["places"]
    assert place["position_metres"] == pytest.approx([0.5 * part for part in place["position"]], rel=1e-4)
    out = run("query", "f.scoup", "kettle", "--out", "b", "--metres-per-unit", "0.5")[1]
    assert re.search(r"in the scene  kettle: at \[.*\], extent .* \(.* m\), thing \d", out)


@pytest.mark.parametrize("motion", ["path", "turntable"])
def test_videos(motion, monkeypatch):
    monkeypatch.setattr("scoup.cli.query.FRAMES", 5)
    ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="imageio-ffmpeg is not installed")
    options = ("--video", motion, "--out", "a", "--always")
    record = run_json("query", "f.scoup", *TEXTS, *options)
    assert record["videos"] == [f"a/{text}_{motion}.mp4" for text in TEXTS]
    for path in record["videos"]:
        reader = ffmpeg.read_frames(path)
        width, height = next(reader)["size"]
        pictures = [np.frombuffer(frame, np.uint8).reshape(height, width, 3) for frame in reader]
        assert len(pictures) == 5
        assert any(np.abs(pictures[0].astype(int) - other).max() > 20 for other in pictures[1:])
