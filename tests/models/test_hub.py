"""The loader of models: this machine first, and one set of errors."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import pytest

from messages import refuses
from scoup.base import FileFormatError, ScoupError
from scoup.models import hub
from scoup.models.concepts import open_concepts
from scoup.models.dense import open_dense_model
from scoup.models.hub import ModelRequest, Pretrained, load_open_clip, load_pretrained
from scoup.models.image import open_image_model
from scoup.models.sam import open_sam
from tiny_models import saved, tiny_clip, tiny_sam

REQUEST = ModelRequest("embedder", "some/model", "do without", revision="abc")


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
    """Nor is a model of the wrong kind tried again."""
    monkeypatch.setattr(hub, "_no_hub", lambda: "HUB cannot be reached")
    for error in (OSError("not here"), ScoupError("it is a cat")):
        load = Mock(side_effect=error)
        with refuses(ScoupError):
            load_pretrained(REQUEST, load)
        load.assert_called_once()


@pytest.mark.parametrize(("variable", "is_asked"), [("", True), ("HTTPS_PROXY", False)])
def test_whether_a_hub_answers_is_asked_unless_a_proxy_stands_between(monkeypatch, variable, is_asked):
    from huggingface_hub import constants

    for name in ("HTTPS_PROXY", "https_proxy", "ALL_PROXY", "all_proxy"):
        monkeypatch.delenv(name, raising=False)
    if variable:
        monkeypatch.setenv(variable, "http://localhost:1")
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", False)
    monkeypatch.setattr(hub.socket, "create_connection", Mock(side_effect=OSError("no route")))
    assert bool(hub._no_hub()) is is_asked
    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    assert "HF_HUB_OFFLINE" in hub._no_hub()


def test_a_folder_is_not_searched_on_the_hub(tmp_path: Path) -> None:
    load = Mock(side_effect=ValueError("damaged\nin many lines"))
    request = ModelRequest("segmenter", "short", "do without", str(tmp_path))
    with refuses(ScoupError):
        load_pretrained(request, load)
    assert [call.args[0].model_id for call in load.call_args_list] == [str(tmp_path)]
    for name in ("tf_model.h5", "model.fp16.safetensors", "model.safetensors"):
        with refuses(ScoupError):  # files that are not read do not matter
            load_pretrained(request, load)
        (tmp_path / name).write_text("version https://git-lfs.github.com/spec/v1\nsize 9\n")
    with refuses(FileFormatError):
        load_pretrained(request, load)


@pytest.mark.parametrize(("open_model", "model", "said"), [
    (open_image_model, "laion/nothing", r"embedder 'laion/nothing' cannot be loaded: .*colors"),
    (open_image_model, tiny_sam, "'sam' models have no image features"),
    (open_dense_model, "dense:nobody/nothing", "embedder 'dense:nobody/nothing' cannot be loaded"),
    (lambda folder: open_dense_model(f"dense:{folder}"), tiny_sam, "no image features; use CLIP, SigLIP or TIPSv2"),
    (open_sam, "sam-vit-h", r"segmenter 'sam-vit-h' cannot be loaded: .*felzenszwalb"),
    (open_sam, tiny_clip, "'clip' is not a SAM model"),
    (open_concepts, tiny_sam, "'sam' is not a model with words; use one of owlv2"),
])  # fmt: skip
def test_what_cannot_be_loaded_is_told(open_model, model, said: str, tmp_path: Path) -> None:
    name = model if isinstance(model, str) else str(saved(model(), tmp_path))
    with pytest.raises(ScoupError, match=said):
        open_model(name)


def test_names_of_open_clip() -> None:
    for name in ("open_clip:", "open_clip:A", "open_clip:A/", "open_clip:/b"):
        with refuses():
            load_open_clip(ModelRequest("embedder", name, "do without"), "cpu")
