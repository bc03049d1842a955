"""The rows of the ablation table."""

from __future__ import annotations

from messages import refuses
from scoup.base import UnknownNameError
from scoup_lab.baselines.sparse import SparseUplift
from scoup_lab.evaluate.published import ABLATIONS as PUBLISHED
from scoup_lab.evaluate.rules import MASK_RULES
from scoup_lab.evaluate.studies.ablation_rows import ABLATIONS, find_ablations


def test_rules_of_rows() -> None:
    protocol = MASK_RULES["scoup"]
    rules = {each.name: each.rule(protocol) for each in ABLATIONS}
    assert [name for name, rule in rules.items() if rule.everyday] == ["beside everyday words"]
    assert [name for name, rule in rules.items() if rule.coded] == [
        "without the 50 % of highest entropy, dropped from blending",
        "without the 50 % of lowest entropy, dropped from blending",
    ]
    assert rules["level by mask"].mask_rule.level_choice == "mask"
    assert rules["only level m"].levels == ("m",)
    assert rules["beside everyday words"].mask_rule == protocol


def test_rows_are_complete() -> None:
    names = [each.name for each in ABLATIONS]
    assert len(set(names)) == len(names)
    assert {each.published for each in ABLATIONS} - {""} == set(PUBLISHED)
    changes = [
        each.method.uplift.changes for each in ABLATIONS if isinstance(each.method.uplift, SparseUplift)
    ]
    sizes = {(each.get("n_atoms"), each.get("k", 4)) for each in changes}
    assert {(32, 4), (64, 4), (128, 4), (64, 2), (64, 8)} <= sizes
    chosen = find_ablations(["atoms"])
    assert chosen[0].name == ABLATIONS[0].name
    assert {each.group for each in chosen[1:]} == {"atoms"}
    assert find_ablations([]) == list(ABLATIONS)
    assert [each.name for each in ABLATIONS if each.is_base] == [ABLATIONS[0].name]
    with refuses(UnknownNameError):
        find_ablations(["atom"])
