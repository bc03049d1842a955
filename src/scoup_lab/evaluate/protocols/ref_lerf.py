"""Ref-LERF: masks of the things that sentences refer to, in the scenes of LERF (docs/protocols.md).

Read from ReferSplat's code (heshuting555/ReferSplat, ``scene/dataset_readers.py``, ``render.py``, ``test_miou.py``;
its copies gml78905/ReferSplat and sleepy-shawn/refersplat-uc for the test frames of all scenes and for the folders of
the released data): the files, mean IoU over masks, a pixel of a true mask being inside where it is not black, and
empty true masks left out. The test frames are those of ``test_json`` where the data are split so, else ``TEST_FRAMES``.

*Choices*: every sentence of a frame is scored, where the code names its files after the category and thereby keeps
the last sentence of each; a field answers by the rules of LERF-OVS (steps 1 to 4 there), where ReferSplat takes its
own mask above one half; a sentence that refers to several things of a frame means all of them; of a scene of another
name, all frames are scored. Views of test frames are used for building, as in all protocols here; sentences are not.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import Tensor

from scoup.base.errors import FileFormatError, MissingFileError
from scoup.base.json_node import JsonNode
from scoup.io.images import read_mask
from scoup.io.reading import read_json
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.protocols.pixels import PixelProtocol

TEST_FRAMES: dict[str, tuple[int, ...]] = {
    "ramen": (6, 24, 60, 65, 81, 119, 128),
    "figurines": (83, 97, 146, 179),
    "teatime": (2, 25, 43, 107, 129, 140),
    "waldo_kitchen": (19, 35, 67, 105, 162),
}
"""Numbers in the names of the test frames."""

_TEST_FOLDERS = ("json/test_json", "test_json")
_ALL = "json"
_MASKS = ("gt_mask", "mask")
_REMEDY = "the file is damaged or not of Ref-LERF"


def sentence_folder(folder: Path) -> Path:
    """Return the folder of a scene with the sentences of its test frames, or of all frames; the latter's place
    if neither is there."""
    found = [folder / name for name in _TEST_FOLDERS if (folder / name).is_dir()]
    return found[0] if found else folder / _ALL


def read_frames(folder: str | Path) -> list[LabelledFrame]:
    """Return the test frames of a scene: ``json/<frame>.json`` with sentences, and the masks they name below
    ``gt_mask``.

    Labels are sentences; there are no boxes. Sentences of nothing but empty masks are left out, and with them frames
    that have no others.
    """
    folder = Path(folder)
    home = sentence_folder(folder)
    if not home.is_dir():
        raise MissingFileError(
            home, "there is no such folder (expected sentences)", "pass a scene of Ref-LERF"
        )
    paths = sorted(path for path in home.iterdir() if path.suffix.lower() == ".json")
    if home.name == _ALL and folder.name in TEST_FRAMES:
        paths = [path for path in paths if _number(path.stem) in TEST_FRAMES[folder.name]]
    if not paths:
        raise MissingFileError(home, "contains no sentences of a test frame (*.json)", "check the path")
    masks = next((folder / name for name in _MASKS if (folder / name).is_dir()), folder / _MASKS[0])
    frames = [_frame(path, masks) for path in paths]
    return [frame for frame in frames if frame.labels]


PROTOCOL = PixelProtocol(
    "ref-lerf",
    "ref-lerf 2D",
    scenes=("ramen", "figurines", "teatime", "waldo_kitchen"),
    labels=lambda root, scene: sentence_folder(root / scene),
    read=lambda root, scene: read_frames(root / scene),
    refers=True,
)


def _number(name: str) -> int | None:
    """Return 6 for ``frame_00006``: the number after the underscore, as ReferSplat's code takes it."""
    digits = name.split("_")[1] if "_" in name else ""
    return int(digits) if digits.isascii() and digits.isdigit() and len(digits) < 19 else None


def _frame(path: Path, masks: Path) -> LabelledFrame:
    found: dict[str, Tensor] = {}
    for item in read_json(path, "sentences of Ref-LERF", _REMEDY).get("object").items():
        mask, sentences = _object(item, masks)
        for sentence in sentences:
            if sentence in found and found[sentence].shape != mask.shape:
                raise FileFormatError(path, "its masks differ in size", "all are of one image")
            found[sentence] = found[sentence] | mask if sentence in found else mask
    if len({mask.shape for mask in found.values()}) > 1:
        raise FileFormatError(path, "its masks differ in size", "all are of one image")
    shown = {sentence: mask for sentence, mask in found.items() if mask.any()}
    height, width = next(iter(found.values())).shape if found else (1, 1)
    return LabelledFrame(path.stem, width, height, shown, {})


def _object(item: JsonNode, masks: Path) -> tuple[Tensor, list[str]]:
    """Return [H, W] boolean mask of an object, and its sentences."""
    name = item.get("segmentation")
    sentences = [sentence.text() for sentence in item.get("sentence").items()]
    place = masks / name.text()
    if not place.resolve().is_relative_to(masks.resolve()):
        raise name.error(f"a mask in {masks.name}")
    return torch.from_numpy(read_mask(place, above=0)), sentences
