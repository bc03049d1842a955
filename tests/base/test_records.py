"""Records as JSON."""

from __future__ import annotations

import json

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scoup.base.texts import rounded_vector
from scoup_lab.bench.report import record_text
from support import examples

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@settings(max_examples=examples(40))
@given(st.dictionaries(st.text(), values))
def test_what_is_written_is_read_again(record: dict) -> None:
    assert json.loads(record_text(record)) == json.loads(json.dumps(record))


def test_lists_stay_on_a_line_and_no_number_is_none() -> None:
    record = {"a": {"b": [1, [2, "3, {"]], "c": {}}, "d": None}
    assert record_text(record) == '{\n "a": {\n  "b": [1, [2, "3, {"]],\n  "c": {}\n },\n "d": null\n}'
    with pytest.raises(ValueError, match="not JSON compliant"):
        record_text({"a": {"b": [float("nan")]}})
    # Six digits, or three decimals.
    found = [rounded_vector([value, 0])[0] for value in (0.00123456789, 12.3456789, 4649776.12345)]
    assert found == [0.00123457, 12.3457, 4649776.123]
