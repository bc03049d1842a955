"""Scenes whose masks and embeddings real models made: "desk" and "fox" (real photographs, splats, labels), and five
whose photographs are renders, with exact truth."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

import torch
from torch import Tensor

import scoup
from scoup.models import CANONICAL_PHRASES
from scoup.scene import Camera, Cameras, Gaussians, Regions
from scoup_lab.data.labels import LabelledFrame, match_frames, read_labels

FOLDERS = {
    "desk": "desk",
    "fox": "fox",
    "museum-real": "real/museum-B",
    **{f"{name}-real": f"real/{name}-20" for name in ("table", "shelves", "hall", "yard")},
}
PHOTOGRAPHED = ("desk", "fox")
"""Places whose photographs are real."""
SECOND = {"fox": {"-17": "language_features_17"}, "museum-real": {}}
"""Place -> ending of a second scene of it -> its regions: by default the same masks, with embeddings pooled in another
way; of fox those of 17 of the 50 photographs."""
REAL_SCENES = {
    place + ending: (folder, regions)
    for place, folder in FOLDERS.items()
    for ending, regions in {
        "": "language_features",
        **SECOND.get(place, {"-all": "language_features_all"}),
    }.items()
}
"""Name of the scene -> its folder and that of its regions. The first are real, the others rendered."""


def place_of(name: str) -> str:
    """Return what the scenes of one place have in common."""
    return name.removesuffix("-all").removesuffix("-17")


@dataclass(frozen=True, eq=False)
class RealScene:
    """The scene without its Gaussians."""

    folder: Path
    cameras: Cameras
    regions: Regions
    frames: list[tuple[LabelledFrame, Camera]]  # labelled photographs with their cameras
    words: tuple[str, ...]  # all names that have a text vector but the canonical phrases
    everyday: Tensor  # [words, D] their unit text vectors
    canonical: Tensor  # [P, D]
    absent: tuple[str, ...]  # those words that nothing in the scene is called
    encoder: scoup.TextEncoder  # desk's table

    @classmethod
    def open(cls, name: str, data: Path) -> RealScene:
        """Open a scene of ``REAL_SCENES`` from the folder of the data."""
        place, features = REAL_SCENES[name]
        folder = data / place
        names = {path.stem for path in (folder / features).glob("*.regions")}
        chosen = scoup.load_cameras(folder).select(lambda camera: Path(camera.name).stem in names)
        return cls.of_folder(folder, features, data, chosen)

    @classmethod
    def of_folder(cls, folder: Path, features: str, data: Path, chosen: Cameras | None = None) -> RealScene:
        """Open a scene that lies anywhere, of all or of chosen views; desk's table has its words."""
        cameras = scoup.load_cameras(folder)
        held_out = folder / "held_out.json"
        labelled = scoup.load_cameras(held_out) if held_out.exists() else cameras
        frames = [
            (frame.resized(camera.width, camera.height), camera)
            for frame, camera in match_frames(read_labels(folder / "label"), labelled)
        ]
        called: set[str] = set()
        if held_out.exists():
            meanings = json.loads((folder / "words.json").read_text())
            frames = [(renamed(frame, meanings), camera) for frame, camera in frames]
            called = set(meanings)
        encoder = scoup.TextEncoder.open(data / "desk" / "desk_words.npz")
        words = tuple(word for word in encoder.names or () if word not in CANONICAL_PHRASES)
        absent = ABSENT.split(",")
        if folder.name == "desk":
            absent = json.loads((folder / "words.json").read_text())["absent"]
        return cls(
            folder,
            chosen or cameras,
            scoup.load_regions(folder / features, chosen or cameras),
            frames,
            words,
            torch.nn.functional.normalize(encoder.encode(words), dim=1),
            encoder.canonical(),
            tuple(word for word in absent if word in words and word not in called),
            encoder,
        )

    def gaussians(self) -> Gaussians:
        """Load the splat."""
        return scoup.load_gaussians(self.folder / "point_cloud.splat")

    def field(self, views: Cameras | None = None) -> scoup.LanguageField:
        """Return the field of all or of some views, which desk's table encodes the texts for."""
        sources = scoup.FieldSources(self.encoder.name)
        built = scoup.build(self.gaussians(), views or self.cameras, self.regions, sources=sources)
        return built.with_encoder(self.encoder)


def renamed(frame: LabelledFrame, meanings: dict[str, list[str]]) -> LabelledFrame:
    """Return a frame by the words of a table: {word: the labels it means}, whose masks are united."""
    masks, boxes = {}, {}
    for word, labels in meanings.items():
        there = [label for label in labels if label in frame.masks]
        if there:
            masks[word] = torch.stack([frame.masks[label] for label in there]).any(0)
            boxes[word] = torch.cat([frame.boxes[label] for label in there])
    return replace(frame, masks=masks, boxes=boxes)


ABSENT = (
    "violin,elephant,surfboard,zebra,piano,snowboard,airplane,horse,toothbrush,refrigerator,"
    "bicycle,giraffe,umbrella,trumpet,sushi,cow,motorcycle,tractor,canoe,skateboard,bathtub,"
    "toilet,traffic light,shark,pizza,wedding cake,crown,helmet,lawn mower,pistol,parachute,"
    "chandelier,wheelchair,hair dryer,grizzly,sailboat,rhinoceros,cannon,fire extinguisher,"
    "fire engine"
)
"""Words for things that none of the scenes but desk contains, or museum calls by that name; separated by commas."""
