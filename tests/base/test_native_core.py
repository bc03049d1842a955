"""The compiled core is found, missed or refused as the user wants, whether or not it was built here."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from unittest.mock import Mock

import pytest

from messages import check_message, refuses, warns
from scoup.base import native
from scoup.base.errors import ScoupWarning, warn_once

MODULE = "scoup._native"


def forget() -> None:
    native.load_core.cache_clear()
    warn_once.cache_clear()


@pytest.fixture(autouse=True)
def _fresh(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """As if nothing had asked for the core yet, and nobody remembers afterwards."""
    monkeypatch.delenv("SCOUP_NATIVE", raising=False)
    forget()
    yield
    forget()


@pytest.fixture
def core(monkeypatch: pytest.MonkeyPatch) -> Mock:
    """Stands for a core on a CPU without AVX-512."""
    built = Mock(use_isa=Mock(side_effect=lambda name: name in ("baseline", "v3")))
    monkeypatch.setitem(sys.modules, MODULE, built)
    return built


@pytest.fixture
def no_core(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, MODULE, None)


def test_a_core_that_was_built(core):
    assert native.native_core() is core
    assert native.missing_reason() is None
    native.warn_if_missing()
    core.use_isa.assert_not_called()


@pytest.mark.usefixtures("no_core")
@pytest.mark.parametrize("platform", ["linux", "darwin", "win32", "sunos5"])
def test_a_core_that_was_not_built(monkeypatch, platform):
    """The message says how a compiler is installed, and a warning says it once."""
    monkeypatch.setattr(sys, "platform", platform)
    assert native.native_core() is None
    check_message(native.missing_reason() or "")
    with warns(ScoupWarning):
        native.warn_if_missing()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        native.warn_if_missing()


@pytest.mark.parametrize("error", [
    ImportError("libstdc++.so.6: version GLIBCXX_3.4.29\nnot found", name=MODULE),
    ModuleNotFoundError("No module named 'elsewhere'", name="elsewhere"),
])  # fmt: skip
def test_a_core_that_does_not_load(monkeypatch, error):
    monkeypatch.setattr(native.importlib, "import_module", Mock(side_effect=error))
    assert native.native_core() is None
    check_message(native.missing_reason() or "")


@pytest.mark.usefixtures("core")
def test_switched_off_it_is_absent_in_silence(monkeypatch):
    monkeypatch.setenv("SCOUP_NATIVE", "off")
    native.warn_if_missing()
    assert native.native_core() is None
    assert native.missing_reason() == "the compiled core is switched off; unset SCOUP_NATIVE to use it"


def test_an_instruction_set_that_the_user_wants(core, monkeypatch):
    monkeypatch.setenv("SCOUP_NATIVE", "v3")
    assert native.native_core() is core
    core.use_isa.assert_called_once_with("v3")


@pytest.mark.usefixtures("core")
@pytest.mark.parametrize("setting", ["v4", "fast"])
def test_settings_that_cannot_be_used(monkeypatch, setting):
    monkeypatch.setenv("SCOUP_NATIVE", setting)
    for ask in (native.native_core, native.missing_reason, native.warn_if_missing):
        with refuses():
            ask()


def test_the_core_that_was_built_here(monkeypatch):
    core = native.native_core()
    if core is None:
        pytest.skip(native.missing_reason() or "")
    best = core.current_isa()
    try:
        monkeypatch.setenv("SCOUP_NATIVE", "baseline")
        forget()
        assert native.native_core() is core
        assert core.current_isa() == "baseline"
        assert not core.use_isa("v5")
        assert core.current_isa() == "baseline"
    finally:
        core.use_isa(best)
