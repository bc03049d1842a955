"""Build and score the `kitchen` scene: top-K vote, no top-K, dense uplift, by the LERF-OVS protocol.

    python -m benchmarks.kitchen --data DATA [--seeds 0 1 2] [--solver adam] [--epochs 4000] [--scale 1.0]
        [--out result.json]

DATA is the folder that holds kitchen/ and clip/ (default: SCOUP_TEST_DATA, else ../shared/data). Geometry and text
vectors of the scene are real, its masks and region embeddings are simulated: scores compare methods with each
other and cannot be set against published LERF-OVS figures.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field, replace
from pathlib import Path
from statistics import mean

import torch
import tyro

import scoup
from benchmarks.data import data_folder
from benchmarks.raster import report
from scoup.base.measuring import timed
from scoup.baselines.dense import dense_uplift
from scoup.baselines.fitted import FittedMethod
from scoup.baselines.method import DEFAULTS, MethodSettings
from scoup.baselines.rasterised_scene import RasterisedScene
from scoup.baselines.sparse import SparseUplift, learn_codes
from scoup.evaluate.data_sets import DATA_SETS, LabelledScene
from scoup.evaluate.label_vectors import encode_labels
from scoup.evaluate.metrics import bootstrap_interval
from scoup.evaluate.scores import SceneScore
from scoup.evaluate.studies.study_scene import StudyScene
from scoup.io import write_text
from scoup.io.labels import match_frames, read_labels
from scoup.query.presets import QUERY_PRESETS
from scoup.uplift.build_settings import BUILD_PRESETS
from scoup.uplift.rasterise import region_sums

METHOD, ALL_ATOMS, DENSE = "top-4 vote", "no top-K", "dense 512-d"


@dataclass(frozen=True)
class Arguments:
    data: Path = field(default_factory=data_folder)
    """Folder that holds kitchen/ and clip/."""
    seeds: tuple[int, ...] = (0, 1, 2)
    """Seeds of the codebook; scores are means over them."""
    solver: str = "adam"
    """How codes are learned: "adam" or "exact"."""
    epochs: int = 4000
    """Epochs of the adam solver."""
    n_atoms: int = 64
    """Atoms of a codebook."""
    scale: float = 1.0
    """Size of the views relative to the original 960 x 720."""
    out: Path | None = None
    """Where to write the figures as JSON."""


def main(arguments: Arguments) -> dict:
    """Run everything and return the figures."""
    kitchen = arguments.data / "kitchen"
    with tempfile.TemporaryDirectory() as folder:
        return score_kitchen(arguments, kitchen, make_features(kitchen, Path(folder)))


def make_features(kitchen: Path, folder: Path) -> Path:
    """Write the scene's simulated region features below ``folder``, by its own script; returns where."""
    features = folder / "language_features"
    script = kitchen / "make_langsplat_features.py"
    command = [sys.executable, str(script), str(kitchen), "--out", str(features)]
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    return features


def score_kitchen(arguments: Arguments, kitchen: Path, features: Path) -> dict:
    """Rasterise once, code once a seed, score every method."""
    seconds: dict[str, float] = {}
    splat = kitchen / "scene" / "model.splat"
    gaussians = scoup.load_gaussians(splat)
    cameras = scoup.load_cameras(kitchen).scaled(arguments.scale)
    regions = scoup.load_regions(features, cameras)
    with timed(seconds, "region sums, all views"):
        sums = region_sums(gaussians, cameras, regions, progress=report)

    rasterised = RasterisedScene(gaussians, cameras, regions, sums=sums)
    fitted: dict[str, FittedMethod] = {DENSE: dense_uplift(rasterised.inputs(), DEFAULTS)}
    for seed in arguments.seeds:
        settings = MethodSettings(
            seed,
            replace(
                BUILD_PRESETS["paper"],
                n_atoms=arguments.n_atoms,
                solver=arguments.solver,
                effort="best",
                epochs=arguments.epochs,
                seed=seed,
            ),
        )
        with timed(seconds, f"coding, seed {seed}"):
            rasterised.inputs().codes(learn_codes, settings.build)
        for name, uplift in ((METHOD, SparseUplift()), (ALL_ATOMS, SparseUplift(keep=0))):
            with timed(seconds, f"vote, {name}, seed {seed}"):
                fitted[f"{name}, seed {seed}"] = uplift(rasterised.inputs(), settings)

    frames = match_frames(read_labels(kitchen / "label"), cameras)
    labelled = LabelledScene(DATA_SETS["lerf-ovs"], "kitchen", kitchen, splat, features, cameras, frames)
    words = kitchen.parent / "clip" / "text_vit_b16_laion2b.npz"
    study = StudyScene(labelled, encode_labels(labelled, str(words)), rasterised)
    with timed(seconds, "scoring"):
        scores = {name: study.score(method, QUERY_PRESETS["scoup"]) for name, method in fitted.items()}
    sizes = {name: method.bytes_per_gaussian for name, method in fitted.items()}
    return summarise(scores, arguments, seconds, sizes)


def summarise(scores: dict[str, SceneScore], arguments: Arguments, seconds: dict, sizes: dict) -> dict:
    """Print the table and collect the figures."""
    pairs = len(next(iter(scores.values())).pairs)
    rows = {}
    for family in (DENSE, ALL_ATOMS, METHOD):
        of_family = [score for name, score in scores.items() if name.startswith(family)]
        # The same (frame, label) pair under several seeds: first the mean over seeds, then the draw of queries.
        ious = [mean(score.pairs[i].iou for score in of_family) for i in range(pairs)]
        interval = bootstrap_interval(ious, [pair.label for pair in of_family[0].pairs])
        rows[family] = {
            "miou": mean(score.miou for score in of_family),
            "miou_by_seed": [round(score.miou, 4) for score in of_family],
            "interval": [interval.low, interval.high],
            "accuracy": mean(score.accuracy for score in of_family),
            "accuracy_by_seed": [round(score.accuracy, 4) for score in of_family],
            "bytes_per_gaussian": next(size for name, size in sizes.items() if name.startswith(family)),
            "ious": ious,
        }
    labels = [pair.label for pair in next(iter(scores.values())).pairs]
    print(
        f"\nkitchen, LERF-OVS 2D protocol, {pairs} (frame, query) pairs, codebook seeds {list(arguments.seeds)}\n"
    )
    print("| method | mIoU | 95 % interval over queries | localisation accuracy | bytes a Gaussian |")
    print("|---|---|---|---|---|")
    for family, row in rows.items():
        low, high = row["interval"]
        print(
            f"| {family} | {row['miou']:.3f} | {low:.3f} to {high:.3f} | {row['accuracy']:.3f} "
            f"| {row['bytes_per_gaussian']:.0f} |"
        )
    print()
    for other in (DENSE, ALL_ATOMS):
        differences = [a - b for a, b in zip(rows[METHOD]["ious"], rows[other]["ious"], strict=True)]
        print(f"{METHOD} minus {other}, paired over queries: {bootstrap_interval(differences, labels)}")
    for name, value in seconds.items():
        print(f"{name}: {value:.1f} s")
    result = {
        "protocol": "lerf-ovs 2D",
        "pairs": pairs,
        "seeds": list(arguments.seeds),
        "solver": arguments.solver,
        "epochs": arguments.epochs,
        "scale": arguments.scale,
        "rows": rows,
        "seconds": seconds,
        "threads": torch.get_num_threads(),
        "torch": torch.__version__,
    }
    if arguments.out is not None:
        write_text(arguments.out, json.dumps(result, indent=1), overwrite=True)
    return result


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
