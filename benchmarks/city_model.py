"""What a city takes, on paper: a model fitted to smaller builds of `benchmarks.city`, checked against larger ones.

    python -m benchmarks.city_model [--measured docs/benchmarks/city.json] [--gaussians 1000000000] [--views 1000000]
        [--districts 1000] [--margin 2] [--price 2.5] [--out FILE.json]

Each quantity is a sum of a few terms with one constant each, none below zero, fitted by least squares of relative
errors: seconds of a stage in Gaussians N, views V, regions R and bytes of region sums B; bytes of memory and of files.
The largest size, the largest number of views and all builds in which both grow are left out of the fit, and predicted.

Then the city: as one scene, whose views and buckets as many processes share as there are districts; and as districts,
each a scene of its own with the Gaussians of its surroundings (MARGIN times its own), one on each machine. Seconds are
of the machine and the threads that were measured; nothing here was measured on a GPU. PRICE is of one machine for one
hour, and an assumption.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from scipy.optimize import nnls

from benchmarks.scenes.city import A_BLOCK, FAR, PITCH
from scoup.base.errors import InputError
from scoup.io import check_output
from scoup_lab.bench import describe_environment, markdown, write_json

Values = Mapping[str, float]
TERMS: dict[str, tuple[str, ...]] = {
    "load": ("N", "1"),
    "coding": ("R", "1"),
    "region sums": ("V seen", "V N", "N"),
    "vote": ("B", "N", "1"),
    "rest": ("N", "V", "1"),
    "bytes_of_splat": ("N",),
    "bytes_of_features": ("V", "V seen"),
    "regions": ("V seen",),
    "bytes_of_sums": ("N", "V seen"),
    "bytes_of_field": ("N", "1"),
    "anonymous": ("N", "R", "1"),
}
"""What each quantity is a sum of; ``rest`` is what the total has beyond the stages. "V seen" are views, each counted by
``reach`` of the city; "V N" is what their frustums hold to the end of the city, which is projected."""
STAGES = ("load", "coding", "region sums", "vote", "rest")
BYTES_OF_EMBEDDING = 512 * 4
BYTES_MAPPED = 59 * 4  # of a Gaussian of SH degree 3 in temporary files (base/scratch.py)


@dataclass(frozen=True)
class Arguments:
    measured: Path = Path("docs/benchmarks/city.json")
    """What `benchmarks.city` has written."""
    gaussians: float = 1e9
    """Of the city."""
    views: float = 1e6
    """Of the city."""
    districts: int = 1000
    """Machines, and processes of the city as one scene."""
    margin: float = 2.0
    """Gaussians of a district with what its views see around it, by those of its own."""
    price: float = 2.5
    """Of one machine for an hour."""
    memory: float = 64e9
    """Bytes of memory of a machine."""
    disk: float = 1e12
    """Bytes of its disk."""
    out: Path | None = None
    """Where to write the figures as JSON."""
    overwrite: bool = False
    """Replace OUT."""


@dataclass(frozen=True)
class Model:
    """The constants of each quantity, by term."""

    constants: Mapping[str, Mapping[str, float]]

    def predict(self, n: float, v: float) -> dict[str, float]:
        """Every quantity of a build of n Gaussians and v views; ``total`` is the sum of the stages."""
        values = terms_of(n, v)
        found: dict[str, float] = {}
        for name in ("regions", "bytes_of_sums", *TERMS):
            values |= {"R": found.get("regions", 0.0), "B": found.get("bytes_of_sums", 0.0)}
            found[name] = sum(constant * values[term] for term, constant in self.constants[name].items())
        return found | {"total": sum(found[stage] for stage in STAGES)}


def main(arguments: Arguments) -> dict[str, Any]:
    """Fit, check, predict the city; print the tables, give the record."""
    if arguments.out is not None:
        check_output(arguments.out, arguments.overwrite)
    cases = [flat(case) for case in json.loads(arguments.measured.read_text())["cases"]]
    fitted, held_out = split(cases)
    model = fit(fitted)
    checks = [checked(model, case) for case in held_out]
    districts = arguments.districts
    one = model.predict(arguments.gaussians, arguments.views)
    each = model.predict(arguments.margin * arguments.gaussians / districts, arguments.views / districts)
    hours = each["total"] / 3600
    alone = {**each, "hours": hours, "machine_hours": hours * districts}
    cities = {"one scene": shared(one, districts), "districts": alone}
    for of_city in cities.values():
        of_city["price"] = arguments.price * of_city["machine_hours"]
    limits = limits_of(model, arguments.memory, arguments.disk)
    print(check_table(checks))
    print(city_table(cities))
    print(limit_table(limits))
    record = {
        "what": "benchmarks.city_model: what a city takes, from the builds of benchmarks.city",
        "machine": describe_environment(),
        "settings": {
            name: value for name, value in vars(arguments).items() if isinstance(value, float | int)
        },
        "constants": model.constants,
        "checks": checks,
        "city": cities,
        "limits": limits,
    }
    if arguments.out is not None:
        write_json(arguments.out, record, arguments.overwrite)
    return record


def terms_of(n: float, v: float) -> dict[str, float]:
    """What follows from Gaussians and views alone."""
    return {"N": n, "V": v, "V N": v * n, "V seen": v * reach(n), "1": 1.0}


def reach(n: float) -> float:
    """How much of the distance up to which things have regions a view along a street has before it, on average over a
    city of n Gaussians: a city ends."""
    width = PITCH * (n / A_BLOCK) ** 0.5
    return 1 - FAR / (2 * width) if width > FAR else width / (2 * FAR)


def flat(case: Mapping[str, Any]) -> dict[str, Any]:
    """A case of the record with all quantities of ``TERMS`` side by side."""
    seconds = case["seconds"]
    known = {stage: seconds[stage] for stage in STAGES if stage != "rest"}
    sizes = {name: case[name] for name in TERMS if name in case and name != "regions"}
    return {
        "grows": case["grows"],
        "N": case["gaussians"],
        "V": case["views"],
        "regions": sum(case["regions"]),
        **sizes,
        **known,
        "rest": max(0.0, seconds["total"] - sum(known.values())),
        "total": seconds["total"],
    }


def split(cases: Sequence[dict[str, Any]]) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """The cases to fit, and those to predict: the largest of each curve, and all in which both grow."""
    largest = {"gaussians": max(case["N"] for case in cases), "views": max(case["V"] for case in cases)}
    position = {"gaussians": "N", "views": "V"}
    held_out = [
        case
        for case in cases
        if case["grows"] == "both" or case[position[case["grows"]]] == largest[case["grows"]]
    ]
    fitted = [case for case in cases if case not in held_out]
    if len(fitted) < 3:
        raise InputError("the model needs three builds at least, besides the largest of each curve")
    return fitted, held_out


def fit(cases: Sequence[dict[str, Any]]) -> Model:
    """The constants that make the squares of relative errors least, none below zero."""
    constants = {}
    for name, terms in TERMS.items():
        rows, weights = [], []
        for case in cases:
            of_terms = terms_of(case["N"], case["V"])
            of_terms |= {"R": case["regions"], "B": case["bytes_of_sums"]}
            rows.append([of_terms[term] for term in terms])
            weights.append(max(case[name], 1e-9))
        scaled = np.array(rows, float) / np.array(weights)[:, None]
        sizes = np.abs(scaled).max(0)
        found, _ = nnls(scaled / sizes, np.ones(len(rows)))
        constants[name] = dict(zip(terms, (found / sizes).tolist(), strict=True))
    return Model(constants)


def checked(model: Model, case: dict[str, Any]) -> dict[str, Any]:
    """A build that was not fitted: what was measured, and the predictions by it."""
    found = model.predict(case["N"], case["V"])
    names = (*STAGES[:-1], "total", "anonymous", "bytes_of_sums", "bytes_of_field")
    return {
        "grows": case["grows"],
        "gaussians": case["N"],
        "views": case["V"],
        "measured": {name: case[name] for name in names},
        "predicted_by_measured": {name: found[name] / max(case[name], 1e-9) for name in names},
    }


def shared(whole: dict[str, float], processes: int) -> dict[str, float]:
    """The city as one scene: views are shared out; one process learns the codes of all regions, and votes."""
    own = {**whole, "region sums": whole["region sums"] / processes}
    hours = sum(own[stage] for stage in STAGES) / 3600
    # All other machines have ended before the merge.
    shards = (own["load"] + own["region sums"]) / 3600
    return {**own, "hours": hours, "machine_hours": hours + shards * (processes - 1)}


def limits_of(model: Model, memory: float, disk: float) -> dict[str, dict[str, float]]:
    """Up to how many Gaussians or views a scene can be built on machines of so much memory and disk, by what breaks."""
    of = model.constants
    kept_splat = of["bytes_of_splat"]["N"] + BYTES_MAPPED
    return {
        "embeddings of all regions, in the process that learns codes": {
            "views": memory / (of["regions"]["V seen"] * BYTES_OF_EMBEDDING)
        },
        "region sums of all views, on the disk of the process that merges": {
            "views": disk / of["bytes_of_sums"]["V seen"]
        },
        "codes of all Gaussians, order and projection, in every process": {
            "Gaussians": memory / of["anonymous"]["N"]
        },
        "splat and what is mapped of it, on the disk of every process": {"Gaussians": disk / kept_splat},
        "numbers of Gaussians in 31 bits": {"Gaussians": 2.0**31},
    }


def limit_table(limits: Mapping[str, Mapping[str, float]]) -> str:
    """One line a limit."""
    rows = [
        [name, *(f"{of[what] / 1e6:,.2f} million" if what in of else "" for what in ("views", "Gaussians"))]
        for name, of in limits.items()
    ]
    return markdown(["what", "views", "Gaussians"], rows, left=1)


def check_table(checks: Sequence[dict[str, Any]]) -> str:
    """Predicted by measured, a line a build."""
    names = list(checks[0]["predicted_by_measured"])
    heads = ["grows", "Gaussians", "views", *(_NAMES.get(name, name) for name in names)]
    rows = [
        [check["grows"], f"{check['gaussians']:,}", f"{check['views']:,}"]
        + [f"{check['predicted_by_measured'][name]:.2f}" for name in names]
        for check in checks
    ]
    return markdown(heads, rows, left=1)


def city_table(cities: Mapping[str, Mapping[str, float]]) -> str:
    """What each way of building the city takes on one of its machines."""
    heads = ["", *cities]
    lines = [(f"{stage}, minutes", [f"{of[stage] / 60:,.2f}" for of in cities.values()]) for stage in STAGES]
    lines += [
        ("all, minutes", [f"{of['hours'] * 60:,.1f}" for of in cities.values()]),
        ("own memory, GB", [f"{of['anonymous'] / 1e9:,.1f}" for of in cities.values()]),
        ("splat read, GB", [f"{of['bytes_of_splat'] / 1e9:,.2f}" for of in cities.values()]),
        ("region features, GB", [f"{of['bytes_of_features'] / 1e9:,.1f}" for of in cities.values()]),
        ("region sums, GB", [f"{of['bytes_of_sums'] / 1e9:,.1f}" for of in cities.values()]),
        ("field, GB", [f"{of['bytes_of_field'] / 1e9:,.2f}" for of in cities.values()]),
        ("price of all machines", [f"{of['price']:,.0f}" for of in cities.values()]),
    ]
    return markdown(heads, [[name, *values] for name, values in lines], left=1)


_NAMES = {
    "anonymous": "own memory",
    "bytes_of_sums": "region sums, bytes",
    "bytes_of_field": "field, bytes",
    "region sums": "region sums, s",
    "load": "load, s",
    "coding": "coding, s",
    "vote": "vote, s",
    "total": "total, s",
}

if __name__ == "__main__":
    main(tyro.cli(Arguments, description=__doc__))
