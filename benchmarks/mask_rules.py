"""Variants of the rules over masks, on real photographs: what becomes of marked things, and of instances."""

from __future__ import annotations

import json
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import scoup
from benchmarks.data import data_folder
from benchmarks.decoded import Decoded
from benchmarks.extract import FOUND, read_pixels
from benchmarks.mask_instances import Labels, instances
from benchmarks.mask_variants import BASE, MOBILE, RULES, SECOND, Rule
from benchmarks.study import Record, Study
from scoup.base.atomic import atomic_file
from scoup.base.counts import spread
from scoup.base.errors import InputError
from scoup.extract import paint
from scoup.extract.automatic_masks import automatic_masks
from scoup.models.onnx_sam import open_onnx_sam
from scoup.models.sam import PointModel, open_sam
from scoup.scene.regions import LEVELS
from scoup_lab.bench import markdown
from scoup_lab.data.labels import LabelledFrame, match_frames, read_labels
from scoup_lab.evaluate.metrics import bootstrap_interval

FATES = ("swallowed", "split", "missing", "mixed")
"""Of a thing without a region: most of it lies in one region that is mostly something else; most of it lies in regions
that are mostly it; most of it lies in no region; anything else."""

Cut = tuple[dict[str, Labels], dict[str, float]]
"""Level -> region of each pixel, and what it took."""


@dataclass(frozen=True, kw_only=True)
class MaskRules(Study):
    """Try variants of the rules over the masks of MobileSAM and SAM 2 tiny on the real scene desk.

    Every point of a photograph is decoded once; each variant chooses among these masks. Seconds are of the processor,
    as if each variant had decoded its points itself. Regions are those that a build reads: painted, one per pixel and
    level. Variants are chosen on every second labelled photograph, the others are held out; SAM 2 tiny cuts the latter.
    Instances are merged from MobileSAM's regions, without embeddings: for each name the thing, or the union of things,
    that fits the marked object best over all views, at half the size of the photographs. No query can know it.
    """

    weights: Path
    """MobileSAM's checkpoint."""
    onnx: Path | None = None
    """Folder of SAM 2 tiny as ONNX; left out if not given."""
    kept: Path | None = None
    """Folder that keeps the regions of each photograph; a run continues from it. Not for other weights."""
    further: int = 2
    """Photographs without labels, for instances."""

    def check(self) -> None:
        if not (data_folder() / "desk").is_dir():
            raise InputError(f"{data_folder() / 'desk'}: there is no such scene; set SCOUP_TEST_DATA")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        folder = data_folder() / "desk"
        cameras = scoup.load_cameras(folder)
        labels = {frame.name: frame for frame in read_labels(folder / "label")}
        paths = sorted((folder / "images_2").glob("*.jpg"))
        further = spread([path for path in paths if path.stem not in labels], self.further)
        models: dict[str, PointModel] = {MOBILE: open_sam(str(self.weights))}
        if self.onnx is not None:
            models[SECOND] = open_onnx_sam(f"onnx:{self.onnx}")
        maps: dict[str, dict[str, dict[str, Labels]]] = {}
        held_out = _halves(list(labels))["held out"]
        for path in sorted([*(path for path in paths if path.stem in labels), *further]):
            of_path = {
                name: model for name, model in models.items() if name == MOBILE or path.stem in held_out
            }
            for name, (painted, figures) in self._cuts(path, of_path).items():
                if RULES[name].model == MOBILE:
                    maps.setdefault(name, {})[cameras[path.stem].name] = painted
                if path.stem in labels:
                    regions = {level: int(of.max()) + 1 for level, of in painted.items()}
                    things = fates(painted, labels[path.stem])
                    yield f"{name}/{path.stem}", {**figures, "regions": regions, "things": things}
        gaussians = scoup.load_gaussians(folder / "point_cloud.splat")
        frames = [
            (frame.resized(camera.width, camera.height), camera)
            for frame, camera in match_frames(list(labels.values()), cameras.scaled(0.5))
        ]
        for name, of_views in maps.items():
            if f"{name}/instances" not in known:
                yield f"{name}/instances", instances(gaussians, cameras, of_views, frames)

    def _cuts(self, path: Path, models: Mapping[str, PointModel]) -> dict[str, Cut]:
        """Return by rule what is made of a photograph; what is kept is not made again."""
        found, image = {}, read_pixels(path)
        for model in models:
            decoded = None
            for name in (name for name, rule in RULES.items() if rule.model == model):
                file = None if self.kept is None else self.kept / f"{path.stem}, {name}.npz"
                if file is not None and file.exists():
                    found[name] = read_cut(file)
                    continue
                decoded = decoded or Decoded(models[model], image)
                found[name] = cut(image, decoded, RULES[name])
                if file is not None:
                    write_cut(found[name], file)
        return found

    def record(self, rows: dict[str, Any]) -> Record:
        halves = _halves({key.split("/")[1] for key in rows} - {"instances"})
        return {
            "photographs": halves,
            "rows": [
                {"rule": rule, "half": half, **_summary(rows, rule, names)}
                for half, names in halves.items()
                for rule in RULES
                if all(f"{rule}/{name}" in rows for name in names)
            ],
        }

    @staticmethod
    def table(record: Record) -> str:
        """Return one row per rule, of the photographs that are held out."""
        body, fast = [], 1.0
        for row in record["rows"]:
            if row["half"] == "held out":
                fast = row["seconds"] if row["rule"] == BASE else fast
                cells = [
                    " / ".join(f"{row[key][level]:.2f}" for level in LEVELS) for key in ("found", *FATES[:3])
                ]
                signed = [
                    "{:+.3f} [{:+.3f}, {:+.3f}]".format(*row["differences"][key]) if key in row else ""
                    for key in ("best", "thing")
                ]
                instances = [f"{row[key]:.3f}" if key in row else "" for key in ("thing", "union")]
                body.append([
                    row["rule"], f"{row['points']:.0f}", f"{row['seconds'] / fast:.2f}", f"{row['regions']:.0f}",
                    f"{row['any']:.3f}", f"{row['best']:.3f}", *cells,
                    *instances, *signed,
                ])  # fmt: skip
        head = [
            "rule",
            "points",
            "CPU seconds / fast",
            "regions",
            "things with a region",
            "IoU of the best",
            "with one at s / m / l",
        ]
        head += [*FATES[:3], "best thing", "best union of things", "best region - fast", "best thing - fast"]
        return markdown(head, body)


def cut(image: NDArray[np.uint8], decoded: Decoded, rule: Rule) -> Cut:
    """Return level -> region of each pixel, -1 for none, as an extraction writes it; and points and CPU seconds."""
    decoded.changed = rule.changed

    def regions() -> dict[str, NDArray[Any]]:
        found = automatic_masks(image, decoded, rule.settings, rule.with_default)
        found = rule.arrange(found, rule.settings)
        return {level: paint(found[level]) for level in (*LEVELS, *(found.keys() - set(LEVELS)))}

    labels, points, seconds = decoded.costs(regions)
    painted = {
        level: (np.unique(np.append(-1, of), return_inverse=True)[1][1:] - 1)
        .reshape(of.shape)
        .astype(np.int16)
        for level, of in labels.items()
    }
    return painted, {"points": points, "seconds": seconds}


def write_cut(found: Cut, path: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    painted, figures = found
    with atomic_file(path, overwrite=True) as file:
        np.savez_compressed(file, allow_pickle=False, figures=np.array(json.dumps(figures)), **painted)


def read_cut(path: Path) -> Cut:
    with np.load(path) as file:
        figures = json.loads(str(file["figures"]))
        return {name: file[name] for name in file.files if name != "figures"}, figures


def fates(painted: Mapping[str, Labels], frame: LabelledFrame) -> Record:
    """Return name -> level -> IoU of the best region, and what became of a thing without one."""
    return {
        name: {level: fate(labels, mask.numpy())[1:] for level, labels in painted.items()}
        for name, mask in frame.masks.items()
    }


def fate(labels: NDArray[np.signedinteger], truth: NDArray[np.bool_]) -> tuple[int, float, str]:
    """Return the region of labels [H, W] with the largest IoU with a thing, the IoU, and "found" or its fate."""
    sizes = np.bincount(labels.ravel() + 1, minlength=2)
    inside = np.bincount(labels[truth] + 1, minlength=len(sizes))
    whole, none = int(truth.sum()), int(inside[0])
    sizes, inside = sizes[1:], inside[1:]
    ious = inside / np.maximum(sizes + whole - inside, 1)
    number, largest = int(ious.argmax()), int(inside.argmax())
    mostly = 2 * inside >= sizes
    if ious[number] >= FOUND:
        became = "found"
    elif none > whole / 2:
        became = "missing"
    elif 2 * inside[largest] >= whole and not mostly[largest]:
        became = "swallowed"
    else:
        became = "split" if 2 * inside[mostly].sum() >= whole else "mixed"
    return number, float(ious[number]), became


def _summary(rows: dict[str, Any], rule: str, frames: list[str]) -> Record:
    """Return means over the things of some photographs, and differences from the preset with their intervals."""
    of = [rows[f"{rule}/{frame}"] for frame in frames]
    things = [thing for row in of for thing in row["things"].values()]
    pairs = _pairs(rows, rule, frames)
    base = _pairs(rows, BASE, frames)
    names = [name for frame in frames for name in rows[f"{rule}/{frame}"]["things"]]
    fate = {
        kind: {level: float(np.mean([thing[level][1] == kind for thing in things])) for level in things[0]}
        for kind in ("found", *FATES)
    }
    return {
        "points": float(np.mean([row["points"] for row in of])),
        "seconds": float(np.mean([row["seconds"] for row in of])),
        "regions": float(np.mean([sum(row["regions"].values()) for row in of])),
        "any": float(np.mean(pairs["best"] >= FOUND)),
        **{key: float(values.mean()) for key, values in pairs.items()},
        **fate,
        "differences": {
            key: [each.mean, each.low, each.high]
            for key in pairs
            for each in [bootstrap_interval((pairs[key] - base[key]).tolist(), names)]
        },
    }


def _pairs(rows: dict[str, Any], rule: str, frames: list[str]) -> dict[str, NDArray[np.float64]]:
    """Return the IoU of each pair of photograph and name: best region of any level; best thing and union, if any."""
    values = []
    for frame in frames:
        ious = rows.get(f"{rule}/instances", {"ious": {}})["ious"].get(frame, {})
        for name, thing in rows[f"{rule}/{frame}"]["things"].items():
            values.append([max(iou for iou, _ in thing.values()), *ious.get(name, [])])
    return dict(zip(("best", "thing", "union"), np.array(values).T, strict=False))


def _halves(frames: Collection[str]) -> dict[str, list[str]]:
    """Return the labelled photographs on which variants are chosen, and those held out."""
    return {"chosen on": sorted(frames)[::2], "held out": sorted(frames)[1::2]}
