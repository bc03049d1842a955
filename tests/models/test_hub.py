"""The loader of models: this machine first, and one set of errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from messages import refuses
from scoup.base import FileFormatError, ScoupError
from scoup.models import hub
from scoup.models.hub import ModelRequest, Pretrained, load_open_clip, load_pretrained

REQUEST = ModelRequest("embedder", "some/model", "do without", revision="abc")


def failing(error: Exception) -> tuple[list[Pretrained], Callable[[Pretrained], None]]:
    """What was tried, and a loader that fails."""
    calls: list[Pretrained] = []

    def load(files: Pretrained) -> None:
        calls.append(files)
        raise error

    return calls, load


def test_the_network_is_used_only_if_the_files_are_not_here(monkeypatch) -> None:
    monkeypatch.setattr(hub, "_no_hub", lambda: "")
    options: list[dict[str, object]] = []

    def load(files: Pretrained) -> str:
        options.append(files.options)
        if files.options.get("local_files_only"):
            raise OSError("not here")
        return files.model_id

    assert load_pretrained(REQUEST, load) == "some/model"
    assert options == [{"revision": "abc", "local_files_only": True}, {"revision": "abc"}]
    options.clear()
    assert load_pretrained(REQUEST, lambda files: options.append(files.options)) is None
    assert len(options) == 1


def test_without_a_hub_nothing_is_tried_and_the_way_round_is_told(monkeypatch) -> None:
    calls, load = failing(OSError("not here"))
    monkeypatch.setattr(hub, "_no_hub", lambda: "HUB cannot be reached")
    with refuses(ScoupError):
        load_pretrained(REQUEST, load)
    assert len(calls) == 1


@pytest.mark.parametrize(("variable", "is_asked"), [("", True), ("HTTPS_PROXY", False)])
def test_whether_a_hub_answers_is_asked_unless_a_proxy_stands_between(
    monkeypatch, variable, is_asked
) -> None:
    from huggingface_hub import constants

    def refuse(*_: object, **__: object) -> None:
        raise OSError("no route")

    for name in ("HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    if variable:
        monkeypatch.setenv(variable, "http://localhost:1")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(hub.socket, "create_connection", refuse)
    assert bool(hub._no_hub()) is is_asked
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    assert "HF_HUB_OFFLINE" in hub._no_hub()


def test_a_model_of_the_wrong_kind_is_not_tried_again() -> None:
    calls, load = failing(ScoupError("it is a cat"))
    with refuses(ScoupError):
        load_pretrained(REQUEST, load)
    assert len(calls) == 1


def test_a_folder_is_not_searched_on_the_hub(tmp_path: Path) -> None:
    calls, load = failing(ValueError("damaged\nin many lines"))
    request = ModelRequest("segmenter", "short", "do without", str(tmp_path))
    with refuses(ScoupError):
        load_pretrained(request, load)
    assert [files.model_id for files in calls] == [str(tmp_path)]
    for name in ("tf_model.h5", "model.fp16.safetensors", "model.safetensors"):
        with refuses(ScoupError):  # files that are not read do not matter
            load_pretrained(request, load)
        (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\nsize 9\n")
    with refuses(FileFormatError):
        load_pretrained(request, load)


def test_names_of_open_clip() -> None:
    for name in ("open_clip:", "open_clip:A", "open_clip:A/", "open_clip:/b"):
        with refuses():
            load_open_clip(ModelRequest("embedder", name, "do without"), "cpu")
