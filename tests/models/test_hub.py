"""The loader of models: this machine first, and one set of errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from scoup.base.errors import InputError, ScoupError
from scoup.models.hub import ModelRequest, Pretrained, load_open_clip, load_pretrained

REQUEST = ModelRequest("embedder", "some/model", "do without", revision="abc")


def test_the_network_is_used_only_if_the_files_are_not_here() -> None:
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


def test_a_model_of_the_wrong_kind_is_not_tried_again() -> None:
    calls: list[Pretrained] = []

    def load(files: Pretrained) -> None:
        calls.append(files)
        raise ScoupError("it is a cat")

    with pytest.raises(ScoupError, match=r"^embedder 'some/model' cannot be loaded: it is a cat$"):
        load_pretrained(REQUEST, load)
    assert len(calls) == 1


def test_a_folder_is_not_searched_on_the_hub(tmp_path: Path) -> None:
    calls: list[Pretrained] = []

    def load(files: Pretrained) -> None:
        calls.append(files)
        raise ValueError("damaged\nin many lines")

    request = ModelRequest("segmenter", "short", "do without", str(tmp_path))
    with pytest.raises(ScoupError, match=r"'short' cannot be loaded \(damaged\); .* or do without$"):
        load_pretrained(request, load)
    assert [files.model_id for files in calls] == [str(tmp_path)]


def test_names_of_open_clip() -> None:
    for name in ("open_clip:", "open_clip:A", "open_clip:A/", "open_clip:/b"):
        with pytest.raises(InputError, match="ARCHITECTURE/PRETRAINED"):
            load_open_clip(ModelRequest("embedder", name, "do without"), "cpu")
