"""How well the scores of a scene tell words for what is there from words for what is not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import mean

import numpy as np

from benchmarks.real_scenes import REAL_SCENES, place_of
from benchmarks.study import Record
from scoup.query import constants
from scoup_lab.bench import markdown

MOST_ABSENT = 40
BOUNDS = (0.2, constants.PRESENT_FROM, 0.45, 0.6, 0.9)
LOST = 0.05
"""Share of the present words of all other scenes that the threshold chosen on them loses."""


def presence_of_groups(
    scores: Record, groups: Mapping[str, Sequence[str]], ways: Sequence[str]
) -> dict[str, dict[str, Record]]:
    """Return per way and group of scenes what ``presence_of_group`` says."""
    found: dict[str, dict[str, Record]] = {}
    for way in ways:
        of = {name: each[way]["presence"] for name, each in scores.items()}
        if any(None in each["present"] for each in of.values()):
            continue
        found[way] = {
            group: presence_of_group({name: of[name] for name in names if of[name]["absent"]})
            for group, names in groups.items()
            if any(of[name]["absent"] for name in names)
        }
        real = {name: of[name] for name in of if name in REAL_SCENES}
        if len({place_of(name) for name in real}) > 1:
            found[way]["all with real models"] = presence_of_group(real)
    return found


def presence_of_group(scenes: Mapping[str, Mapping[str, Sequence[float]]]) -> Record:
    """Return means over scenes: AUC; shares of present words kept and of absent ones refused by the bound, and by the
    threshold chosen on the other scenes (both poolings of a scene count as one).
    """
    present = {name: np.array(of["present"]) for name, of in scenes.items()}
    absent = {name: np.array(of["absent"]) for name, of in scenes.items()}
    record: Record = {
        "words": [sum(map(len, present.values())), sum(map(len, absent.values()))],
        "AUC": round(mean(auc(present[name], absent[name]) for name in scenes), 4),
        "from": {f"{bound:g}": _shares(present, absent, dict.fromkeys(scenes, bound)) for bound in BOUNDS},
    }
    if len({place_of(name) for name in scenes}) > 1:
        elsewhere = {
            name: float(
                np.quantile(
                    np.concatenate([present[other] for other in scenes if place_of(other) != place_of(name)]),
                    LOST,
                )
            )
            for name in scenes
        }
        record["chosen elsewhere"] = _shares(present, absent, elsewhere)
        record["thresholds"] = {name: round(bound, 4) for name, bound in elsewhere.items()}
    return record


def presence_table(record: Mapping[str, Mapping[str, Record]]) -> str:
    """Return AUC, and kept / refused by the bound, per way and group of scenes."""
    body = []
    for way, groups in record.items():
        for group, of in groups.items():
            bounds = ["{:.2f} / {:.2f}".format(*of["from"][f"{bound:g}"]) for bound in BOUNDS]
            chosen = "{:.2f} / {:.2f}".format(*of["chosen elsewhere"]) if "chosen elsewhere" in of else ""
            body.append([way, group, f"{of['AUC']:.3f}", *bounds, chosen])
    heads = [f"from {bound:g}" for bound in BOUNDS]
    return markdown(["way", "kept / refused", "AUC", *heads, "threshold chosen on the other scenes"], body)


def auc(higher: np.ndarray, lower: np.ndarray) -> float:
    """Return the chance that one of the first is above one of the second, ties half."""
    above = (higher[:, None] > lower).mean() + 0.5 * (higher[:, None] == lower).mean()
    return float(above)


def _shares(
    present: Mapping[str, np.ndarray], absent: Mapping[str, np.ndarray], bounds: Mapping[str, float]
) -> list[float]:
    kept = mean(float((present[name] >= bound).mean()) for name, bound in bounds.items())
    refused = mean(float((absent[name] < bound).mean()) for name, bound in bounds.items())
    return [round(kept, 4), round(refused, 4)]
