"""Records as JSON, short texts of lists and tensors, loops that work ahead, and errors."""

from __future__ import annotations

import inspect
import json
import pickle

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

import scoup
from scoup.base import errors
from scoup.base.texts import listed, rounded_vector, share_of, spread
from scoup.base.work import worked_ahead
from scoup.query import TextVectors
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


def test_long_lists_are_shortened() -> None:
    assert [listed("abcd"[:length]) for length in (0, 1, 3, 4)] == ["", "a", "a, b, c", "a, b, c, ..."]
    assert [share_of(1, total, "camera") for total in (1, 2)] == ["the only camera", "1 of 2 cameras"]
    assert [spread(list(range(count)), 8) for count in (0, 3, 16)] == [[], [0, 1, 2], list(range(1, 16, 2))]
    codes = scoup.SparseCodes(torch.zeros(5, 2, dtype=torch.uint8), torch.zeros(5, 2), 8)
    assert repr(codes) == "SparseCodes(indices=uint8 [5, 2], weights=float32 [5, 2], n_atoms=8)"
    names = tuple(f"a thing with a long name {number}" for number in range(100))
    texts = TextVectors(names, torch.zeros(100, 4), torch.zeros(4, 4), torch.zeros(9, 4))
    assert len(repr(texts)) < 300


def test_results_of_a_loop_come_in_order_and_few_are_made_ahead() -> None:
    started: list[int] = []

    def work(item: int) -> int:
        started.append(item)
        return item * item

    for number, (item, future) in enumerate(worked_ahead(work, range(20), 3)):
        assert (item, future.result()) == (number, number**2)
        assert len(started) <= number + 4
    assert sorted(started) == list(range(20))


# ---- errors travel between processes unchanged


ONE_OF_EACH = [
    errors.ScoupError("said"), errors.InputError("said"),
    errors.FileFormatError("a.ply", "is damaged", "make it again"), errors.FieldVersionError("a.scoup", 9, 3),
    errors.MissingFileError("a.ply", "is not there"), errors.OutputExistsError("a.scoup"),
    errors.WriteError("a.scoup", "No space left on device", "free some space"), errors.OutputInUseError("a.scoup"),
    errors.UnknownNameError("camera", "b", [f"a{number}" for number in range(9)], "scene"),
]  # fmt: skip


def test_a_file_that_vanished_is_named() -> None:
    said = "a.ply: disappeared while being read; restore it and retry"
    assert str(errors.FileFormatError.unreadable("a.ply", FileNotFoundError("a.ply"))) == said


def test_each_can_be_sent() -> None:
    classes = [item for _, item in inspect.getmembers(errors, inspect.isclass)]
    assert {type(error) for error in ONE_OF_EACH} == {
        item for item in classes if issubclass(item, errors.ScoupError)
    }
    for error in ONE_OF_EACH:
        other = pickle.loads(pickle.dumps(error))
        assert type(other) is type(error)
        assert str(other) == str(error)
        assert vars(other) == vars(error)
        assert str(pickle.loads(pickle.dumps(other))) == str(error)
