"""Tables that other packages extend: what they find, and what they do about damaged packages."""

from __future__ import annotations

import sys
import warnings
from pathlib import Path

import pytest

from scoup.base.errors import ScoupWarning, UnknownNameError, warn_once
from scoup.base.registry import Entry, Registry

OWN = [Entry("red"), Entry("pale:COLOUR"), Entry("pale:dark:COLOUR", help="of two prefixes")]


@pytest.fixture
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A package with entry points, given as lines."""

    def install(module: str, *points: str) -> Registry[Entry]:
        (tmp_path / "paints.py").write_text(f"from scoup.base.registry import Entry\n{module}")
        folder = tmp_path / "paints-1.0.dist-info"
        folder.mkdir()
        (folder / "METADATA").write_text("Metadata-Version: 2.1\nName: paints\nVersion: 1.0\n")
        (folder / "entry_points.txt").write_text("\n".join(["[some.colours]", *points]))
        monkeypatch.syspath_prepend(tmp_path)
        monkeypatch.delitem(sys.modules, "paints", raising=False)
        warn_once.cache_clear()
        return Registry("colour", "some.colours", Entry, OWN)

    yield install
    sys.modules.pop("paints", None)


def test_own_entries_by_name_and_prefix() -> None:
    table = Registry("colour", "some.colours", Entry, OWN)
    assert list(table) == ["red", "pale:COLOUR", "pale:dark:COLOUR"]
    assert table["red"] is table.find("red") is OWN[0]
    assert table.find("pale:blue") is OWN[1]
    assert table.find("pale:dark:blue") is OWN[2]
    for look in (table.find, table.__getitem__):
        with pytest.raises(UnknownNameError, match="no colour named 'reed'; nearest names: 'red'"):
            look("reed")
    assert "redder" not in table


def test_entries_of_other_packages_follow(installed) -> None:
    table = installed("BLUE = Entry('blue', help='of the sky')\n", "sky = paints:BLUE")
    assert "paints" not in sys.modules
    assert table["red"] is OWN[0]
    assert "paints" not in sys.modules  # only what the project lacks is looked for elsewhere
    assert list(table)[3:] == ["blue"]
    assert table.find("blue").help == "of the sky"


@pytest.mark.parametrize(("module", "problem"), [
    ("raise SystemError('no brush')\n", ".SystemError: no brush."),
    ("", ".AttributeError"),
    ("BLUE = 'blue'\n", ".TypeError: it is not of the class Entry"),
    ("BLUE = Entry('red')\n", ".ValueError: the name 'red' is taken"),
])  # fmt: skip
def test_a_damaged_package_is_one_warning(installed, module: str, problem: str) -> None:
    table = installed(module, "sky = paints:BLUE")
    with pytest.warns(
        ScoupWarning, match=f"the package 'paints': 'sky' of its some.colours is left out {problem}"
    ):
        assert list(table) == [entry.name for entry in OWN]
    assert table["red"] is OWN[0]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        list(table)
