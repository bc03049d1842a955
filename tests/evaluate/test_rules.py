"""Rules of the papers."""

from __future__ import annotations

import pytest

from scoup.base.errors import UnknownNameError
from scoup_lab.evaluate.protocols import PIXELS
from scoup_lab.evaluate.rules import DATASET_THRESHOLDS, MASK_RULES, MaskRule, mask_rule


def test_rules_are_those_of_the_protocols() -> None:
    """Box, threshold, mask smoothing and level rule, as docs/evaluation.md states them."""
    assert {
        "scoup": MaskRule("scoup", 7, "inside", 0.6, 7, "peak", "inside"),
        "langsplatv2": MaskRule("langsplatv2", 29, "inside", 0.4, 7, "peak", "inside"),
        "langsplat": MaskRule("langsplat", 30, "reflect", 0.4, 7, "peak", "but last"),
    } == MASK_RULES
    assert PIXELS["3d-ovs"].rule().level_choice == PIXELS["mipnerf360"].rule().level_choice == "mask"


def test_rules_by_system_and_data_set() -> None:
    assert all(mask_rule(system) == rule for system, rule in MASK_RULES.items())
    assert mask_rule("scoup", "3d-ovs").threshold == 0.3
    assert mask_rule("langsplatv2", "mipnerf360") == MASK_RULES["langsplatv2"]
    for thresholds in DATASET_THRESHOLDS.values():
        assert set(thresholds) <= set(MASK_RULES)
    with pytest.raises(UnknownNameError, match="scoup"):
        mask_rule("skoup")
    with pytest.raises(UnknownNameError, match="3d-ovs"):
        mask_rule("langsplat", "3d-ovs")
