"""Presets of a query."""

from __future__ import annotations

from dataclasses import replace

import pytest

from scoup.base.errors import InputError, UnknownNameError
from scoup.query.presets import DATASET_THRESHOLDS, QUERY_PRESETS, QueryPreset, query_preset


def test_presets_by_name_and_data_set() -> None:
    assert query_preset("scoup") == QUERY_PRESETS["scoup"]
    assert query_preset("scoup", "3d-ovs").threshold == 0.3
    assert next(iter(QUERY_PRESETS)) == "default"
    for dataset, thresholds in DATASET_THRESHOLDS.items():
        everyday, paper = query_preset("default", dataset), query_preset("scoup", dataset)
        assert everyday == replace(paper, name="default", threshold=None, level_choice="evidence"), thresholds
        assert paper.threshold is not None
    assert query_preset("langsplatv2", "mipnerf360") == QueryPreset("langsplatv2", 29, "inside", 0.4, 7)
    assert query_preset("langsplat", threshold=0.1).threshold == 0.1
    assert query_preset("default", threshold=0.1).threshold == 0.1
    with pytest.raises(UnknownNameError, match="scoup"):
        query_preset("skoup")
    with pytest.raises(UnknownNameError):
        query_preset("langsplat", "3d-ovs")
    with pytest.raises(UnknownNameError):
        query_preset("scoup", "imagenet")
    with pytest.raises(InputError):
        query_preset("scoup", threshold=1.5)
    with pytest.raises(InputError):
        QueryPreset("x", 0, "inside", 0.5, 1)
    with pytest.raises(InputError, match="peek"):
        QueryPreset("x", 7, "inside", 0.5, 1, "peek")  # pyright: ignore
