"""Codes learned through renderings (LangSplatV2, our reimplementation) beside sparse code uplifting, in one run:
seconds, memory, loss, and scores by the protocol of LERF-OVS.

    python -m benchmarks.joint [--scene table-0] [--n-gaussians 20000] [--iterations 100 1000]
        [--methods sparse paper dense] [--out docs/benchmarks/joint.json]

A small synthetic scene, as `scoup eval synthetic` writes it; labelled views are among those learned from. Seconds are
from Gaussians, cameras and regions to the fitted method: rasterising and everything after; peak memory is that of
everything after. LangSplatV2 takes 10000 steps a level; seconds for these are extrapolated from the longest run here.
Steps here multiply with kept blending weights of small views in place of rasterising
(``scoup_lab.baselines.joint_codes``), so that ratios are lower than with steps as LangSplatV2 makes them. Scores are
those of simulated regions: they compare methods with each other, and cannot be set against published figures.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import mean
from typing import Any

import tyro

from benchmarks.scenes import find_layout
from scoup.base.errors import InputError
from scoup.io import check_output
from scoup_lab.baselines.fitted import FittedMethod
from scoup_lab.baselines.joint_codes import LANGSPLATV2, JointCodes
from scoup_lab.baselines.method import Method, MethodSettings, Uplift
from scoup_lab.baselines.methods import find_method
from scoup_lab.baselines.rasterised_scene import UpliftInputs
from scoup_lab.baselines.trained import joint_field, learn_joint_codes
from scoup_lab.bench import describe_environment, markdown, write_json
from scoup_lab.bench.environment import in_one_line
from scoup_lab.bench.measure import torch_threads
from scoup_lab.bench.measuring import Cost, Meter
from scoup_lab.evaluate.data_sets import data_set_preset, find_data_set, open_scene
from scoup_lab.evaluate.label_vectors import encode_labels
from scoup_lab.evaluate.scores import accuracy_interval, miou_interval
from scoup_lab.evaluate.studies.comparison import MethodResult, compare
from scoup_lab.evaluate.studies.study_scene import StudyScene, open_study_scene
from scoup_lab.synthetic.data_sets import DataSetSize, write_data_set

DATA_SET = "lerf-ovs"
CURVE_POINTS = 20


@dataclass(frozen=True)
class Arguments:
    scene: str = "table-0"
    """Layout of benchmarks.scenes and a seed."""
    n_gaussians: int = 20_000
    """Of the scene."""
    views: int = 16
    """Views with regions."""
    labelled: int = 4
    """How many of them have labels."""
    width: int = 320
    """Of the views in pixels; heights are three quarters of it."""
    iterations: tuple[int, ...] = (100, 1000)
    """Steps a level of the codes learned through renderings; a run for each."""
    training_width: int = LANGSPLATV2.width
    """Of the views they are learned from, in pixels."""
    methods: tuple[str, ...] = ("sparse", "paper", "dense")
    """What they are set beside, see `scoup eval baselines`."""
    epochs: int = 4000
    """Of the paper's Adam."""
    threads: int = 1
    """Threads."""
    seed: int = 0
    """Of the methods."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


class Joint:
    """The method ``joint-codes`` with a number of steps, which remembers what it learned."""

    def __init__(self, iterations: int) -> None:
        self.iterations = iterations
        self.found: JointCodes | None = None

    def __call__(self, inputs: UpliftInputs, settings: MethodSettings) -> FittedMethod:
        """See ``Uplift``."""
        joint = replace(settings.joint, iterations=self.iterations)
        self.found = learn_joint_codes(inputs, replace(settings, joint=joint))
        return joint_field(inputs, self.found)


class Measured:
    """An ``Uplift`` whose cost is remembered."""

    def __init__(self, uplift: Uplift) -> None:
        self.uplift = uplift
        self.cost = Cost(0.0, None)
        self.cpu_s = 0.0

    def __call__(self, inputs: UpliftInputs, settings: MethodSettings) -> FittedMethod:
        """See ``Uplift``."""
        give_memory_back()
        with Meter() as meter:
            started = time.process_time()
            fitted = self.uplift(inputs, settings)
            self.cpu_s = time.process_time() - started
        self.cost = meter.cost
        return fitted


def main(arguments: Arguments) -> dict[str, Any]:
    """Make the scene, fit and score all, print the tables, give the record."""
    if not arguments.iterations or min(arguments.iterations) < 1:
        raise InputError("name one number of steps or more, each at least 1, with --iterations")
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    environment = describe_environment()
    joints = [Joint(count) for count in sorted(arguments.iterations)]
    methods = [find_method(name) for name in arguments.methods]
    methods += [Method(f"joint-codes, {joint.iterations} steps", joint) for joint in joints]
    measured = [Measured(method.uplift) for method in methods]
    methods = [replace(method, uplift=uplift) for method, uplift in zip(methods, measured, strict=True)]
    settings = MethodSettings(arguments.seed, joint=replace(LANGSPLATV2, width=arguments.training_width))
    settings = replace(settings, build=replace(settings.build, epochs=arguments.epochs))
    preset = data_set_preset(find_data_set(DATA_SET), "scoup")
    with tempfile.TemporaryDirectory() as folder, torch_threads(arguments.threads):
        scene = make_scene(arguments, Path(folder))
        raster_cpu_s = [rasterising(scene, method) for method in methods]
        results = compare([scene], methods, preset, settings)
        levels = len(scene.rasterised.regions.levels)
    # Of equal pixels only the first method has rasterised.
    by_pixels = {method.pixels: cpu for method, cpu in zip(methods[::-1], raster_cpu_s[::-1], strict=True)}
    rows = {}
    for method, uplift, result in zip(methods, measured, results, strict=True):
        rows[method.name] = row(result, uplift, by_pixels[method.pixels])
    for joint, name in zip(joints, list(rows)[-len(joints) :], strict=True):
        assert joint.found is not None
        rows[name].update(joint_row(joint.found))
    record = {
        "what": "benchmarks.joint: codes learned through renderings beside sparse code uplifting",
        "machine": environment,
        "settings": {**vars(arguments), "out": None, "protocol": results[0].score.protocol},
        "methods": rows,
        "published": published(rows, list(rows)[-1], levels),
    }
    print(in_one_line(environment))
    print(tables(record))
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def make_scene(arguments: Arguments, root: Path) -> StudyScene:
    """A synthetic scene in the layout of LERF-OVS, written below a folder and opened again."""
    layout, _, seed = arguments.scene.rpartition("-")
    size = DataSetSize(
        arguments.n_gaussians,
        arguments.width,
        arguments.width * 3 // 4,
        arguments.views,
        arguments.labelled,
    )
    (name,) = write_data_set(DATA_SET, root, [find_layout(layout)], size, [int(seed)])
    labelled = open_scene(find_data_set(DATA_SET), root, name)
    return open_study_scene(labelled, encode_labels(labelled, str(root / name / "text.npz")))


def rasterising(scene: StudyScene, method: Method) -> float:
    """CPU seconds until the region sums that a method needs are there; those of before are kept."""
    started = time.process_time()
    scene.rasterised.region_sums(method.pixels)
    return time.process_time() - started


def give_memory_back() -> None:
    """Return freed memory to the system, where the C library can, so that what a method takes is counted."""
    gc.collect()
    with contextlib.suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)


def row(result: MethodResult, measured: Measured, raster_cpu_s: float) -> dict[str, Any]:
    """Figures of a method. Codes learned through renderings rasterise for themselves, within the fit."""
    own = isinstance(measured.uplift, Joint)
    raster_s, raster_cpu_s = (0.0, 0.0) if own else (result.rasterise_seconds, raster_cpu_s)
    interval, found = miou_interval([result.score]), accuracy_interval([result.score])
    return {
        "miou": interval.mean,
        "miou_interval": interval.ends,
        "localisation": None if found is None else found.mean,
        "rasterise_s": raster_s,
        "fit_s": measured.cost.seconds,
        "total_s": raster_s + measured.cost.seconds,
        "cpu_s": raster_cpu_s + measured.cpu_s,
        "peak_bytes": measured.cost.peak_bytes,
        "bytes_per_gaussian": result.bytes_per_gaussian,
    }


def joint_row(found: JointCodes) -> dict[str, Any]:
    """Further figures of codes learned through renderings."""
    steps = sum(len(of_level) for of_level in found.losses)
    return {
        "steps": steps,
        "loss": [curve(of_level) for of_level in found.losses],
    }


def curve(losses: Sequence[float]) -> list[list[float]]:
    """[step, mean loss since the point before] of some points, spread evenly."""
    count = min(CURVE_POINTS, len(losses))
    ends = [round((place + 1) * len(losses) / count) for place in range(count)]
    return [
        [end, round(mean(losses[start:end]), 5)] for start, end in zip([0, *ends[:-1]], ends, strict=True)
    ]


def published(rows: dict[str, dict[str, Any]], longest: str, levels: int) -> dict[str, Any]:
    """Seconds of LangSplatV2's number of steps, in proportion to those of the longest run, and how many times those of
    each other method they are; by the clock and by the CPU, which a busy machine changes less."""
    more = LANGSPLATV2.iterations * levels / rows[longest]["steps"]
    found: dict[str, Any] = {"iterations": LANGSPLATV2.iterations, "from": longest}
    for kind in ("total_s", "cpu_s"):
        seconds = rows[longest][kind]
        others = {name: of[kind] for name, of in rows.items() if "steps" not in of}
        found[kind] = {
            "extrapolated": more * seconds,
            "times": {name: more * seconds / each for name, each in others.items()},
            "measured_times": {name: seconds / each for name, each in others.items()},
        }
    return found


def tables(record: dict[str, Any]) -> str:
    """Markdown of a record."""
    body = []
    for name, of in record["methods"].items():
        found, peak = of["localisation"], of["peak_bytes"]
        body.append([
            name,
            f"{100 * of['miou']:.1f}",
            "-" if found is None else f"{100 * found:.1f}",
            f"{of['total_s']:.2f}",
            f"{of['cpu_s']:.2f}",
            "-" if peak is None else f"{peak / 1e6:.0f}",
            f"{of['loss'][0][-1][1]:.3f}" if "loss" in of else "-",
        ])  # fmt: skip
    heads = [
        "method",
        "mIoU",
        "localisation",
        "seconds",
        "CPU seconds",
        "peak memory, MB",
        "loss at the end, level s",
    ]
    far = record["published"]
    lines = [f"{far['iterations']} steps a level, extrapolated from {far['from']}:"]
    for kind, said in (("total_s", "seconds"), ("cpu_s", "CPU seconds")):
        ratios = ", ".join(f"{value:.0f} times {name}" for name, value in far[kind]["times"].items())
        lines.append(f"{far[kind]['extrapolated']:.0f} {said}: {ratios}")
    return f"{markdown(heads, body)}\n\n" + "\n".join(lines)


if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
