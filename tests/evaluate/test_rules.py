"""Rules of the papers."""

from __future__ import annotations

from messages import refuses
from scoup.base import UnknownNameError
from scoup_lab.evaluate.protocols import PIXELS
from scoup_lab.evaluate.rules import MASK_RULES, MaskRule


def test_rules_are_those_of_the_protocols() -> None:
    """Box, threshold, mask smoothing and level rule, as docs/evaluation.md states them."""
    assert {
        "scoup": MaskRule("scoup", 7, "inside", 0.6, 7, "peak", "inside"),
        "langsplatv2": MaskRule("langsplatv2", 29, "inside", 0.4, 7, "peak", "inside"),
        "langsplat": MaskRule("langsplat", 30, "reflect", 0.4, 7, "peak", "but last"),
    } == MASK_RULES
    assert PIXELS["3d-ovs"].rule().level_choice == PIXELS["mipnerf360"].rule().level_choice == "mask"


def test_rules_by_system_and_data_set() -> None:
    assert all(PIXELS["lerf-ovs"].rule(system) == rule for system, rule in MASK_RULES.items())
    assert PIXELS["3d-ovs"].rule("scoup").threshold == 0.3
    assert PIXELS["mipnerf360"].rule("langsplatv2").threshold == MASK_RULES["langsplatv2"].threshold
    for protocol in PIXELS.values():
        assert set(protocol.thresholds) <= set(MASK_RULES)
    with refuses(UnknownNameError):
        PIXELS["lerf-ovs"].rule("skoup")
    with refuses(UnknownNameError):
        PIXELS["3d-ovs"].rule("langsplat")
