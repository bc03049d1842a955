"""Errors travel between processes unchanged."""

from __future__ import annotations

import inspect
import pickle

from scoup.base import errors

ONE_OF_EACH = [
    errors.ScoupError("said"),
    errors.InputError("said"),
    errors.FileFormatError("a.ply", "is damaged", "make it again"),
    errors.FieldVersionError("a.scoup", 9, 3),
    errors.MissingFileError("a.ply", "is not there"),
    errors.OutputExistsError("a.scoup"),
    errors.WriteError("a.scoup", "No space left on device", "free some space"),
    errors.OutputInUseError("a.scoup"),
    errors.UnknownNameError("camera", "b", [f"a{number}" for number in range(9)], "scene"),
]


def test_a_file_that_vanished_is_named() -> None:
    said = "a.ply: disappeared while being read; restore it and retry"
    assert str(errors.refused_read("a.ply", FileNotFoundError("a.ply"))) == said


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
