"""Errors travel between processes unchanged."""

from __future__ import annotations

import inspect
import pickle

import pytest

from scoup.base import errors
from scoup.base.errors import (
    FieldVersionError,
    FileFormatError,
    GeometryMismatchError,
    InputError,
    MissingFileError,
    OutputExistsError,
    OutputInUseError,
    ScoupError,
    UnknownNameError,
    WriteError,
)

ONE_OF_EACH = [
    ScoupError("said"),
    InputError("said"),
    FileFormatError("a.ply", "is damaged", "make it again"),
    FieldVersionError("a.scoup", 9, 3),
    MissingFileError("a.ply", "is not there"),
    GeometryMismatchError("said"),
    OutputExistsError("a.scoup"),
    WriteError("a.scoup", "No space left on device", "free some space"),
    OutputInUseError("a.scoup"),
    UnknownNameError("camera", "b", [f"a{number}" for number in range(9)], "scene"),
]


def test_there_is_one_of_each() -> None:
    classes = {
        item for _, item in inspect.getmembers(errors, inspect.isclass) if issubclass(item, ScoupError)
    }
    assert {type(error) for error in ONE_OF_EACH} == classes


@pytest.mark.parametrize("error", ONE_OF_EACH, ids=lambda error: type(error).__name__)
def test_they_can_be_sent(error: ScoupError) -> None:
    other = pickle.loads(pickle.dumps(error))
    assert type(other) is type(error)
    assert str(other) == str(error)
    assert vars(other) == vars(error)
    assert str(pickle.loads(pickle.dumps(other))) == str(error)
