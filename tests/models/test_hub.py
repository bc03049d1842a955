"""The loader of models: this machine first, then a hub; and models that do not load: what they are, and what to use, in
our words."""

from __future__ import annotations

from pathlib import Path
from unittest.mock import Mock

import pytest
import torch

from messages import refuses
from scoup.base import FileFormatError, ScoupError
from scoup.models import hub
from scoup.models.concepts import open_concepts
from scoup.models.dense import open_dense_model
from scoup.models.hub import ModelRequest, Pretrained, _open_clip_parts, load_open_clip, load_pretrained
from scoup.models.image import open_image_model
from scoup.models.sam import open_sam
from scoup.models.towers import load_tower
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


SAM_2 = {"image_encoder.trunk.pos_embed": (1, 8, 7, 7)}
OF_96 = {"image_encoder.trunk.patch_embed.proj.weight": (96, 3, 7, 7)}
PUBLISHED = {
    "sam2.1_hiera_tiny.pt": SAM_2,
    "sam2_hiera_base_plus.pt": SAM_2,
    "renamed.pt": {**OF_96, **{f"image_encoder.trunk.blocks.{n}.norm1.weight": (1,) for n in range(16)}},
    "newer.pt": {
        **OF_96,
        **{f"image_encoder.trunk.blocks.{n}.norm1.weight": (1,) for n in range(12)},
        "no_obj_embed_spatial": (1,),
    },
    "edgetam.pt": {"image_encoder.trunk.body.stem.weight": (1,)},
    "sam3.pt": {"detector.backbone.x": (1,)},
    "sam_hq_vit_b.pth": {
        "mask_decoder.hf_token.weight": (1, 256),
        "image_encoder.pos_embed": (1, 64, 64, 768),
    },
    "sam_vit_h_4b8939.pth": {"image_encoder.pos_embed": (1, 64, 64, 1280)},
}


@pytest.mark.parametrize("file", PUBLISHED)
def test_published_weights_of_other_segmenters(file: str, tmp_path: Path) -> None:
    one = torch.zeros(())  # which a file of any shape is then made of
    weights = {name: one.expand(shape) for name, shape in PUBLISHED[file].items()}
    torch.save(weights if file.endswith("pth") else {"model": weights}, tmp_path / file)
    with refuses(ScoupError):
        open_sam(str(tmp_path / file))


def test_files_of_whole_objects_and_damaged_ones(tmp_path: Path) -> None:
    torch.save({"model": torch.nn.Linear(2, 2)}, tmp_path / "FastSAM-x.pt")
    torch.save({"weight": torch.zeros(99)}, tmp_path / "cut.pt")
    (tmp_path / "cut.pt").write_bytes((tmp_path / "cut.pt").read_bytes()[:300])
    for file in ("FastSAM-x.pt", "cut.pt"):
        with refuses(ScoupError):
            open_sam(str(tmp_path / file))


def test_folders_that_are_not_models(tmp_path: Path) -> None:
    folder = saved(tiny_clip(), tmp_path / "clip")
    contents: list[dict[str, str | None]] = [
        {"model.safetensors": "cut"}, {"config.json": '{"model_type": "\\u001b[1mnew"}'}, {"model.safetensors": None},
        {"config.json": "{}"}, {"config.json": "{"}, {"config.json": "[" * 100_000}, {"config.json": None},
        {"config.json": "{}", "open_clip_config.json": "{}", "open_clip_model.safetensors": ""},
    ]  # fmt: skip
    for files in contents:
        for name, content in files.items():
            if content is None:
                (folder / name).unlink()
            else:
                (folder / name).write_text(content)
        with refuses(ScoupError):
            open_image_model(str(folder))


def test_refusals_of_the_hub(monkeypatch: pytest.MonkeyPatch) -> None:
    class GatedRepoError(Exception):
        pass

    def load(files: Pretrained) -> None:
        try:
            raise GatedRepoError("\x1b[1mread the manual of `model_type`")
        except GatedRepoError as error:
            raise OSError("make sure to have access") from error

    monkeypatch.setattr(hub, "_no_hub", lambda: "")
    with refuses(ScoupError):
        load_pretrained(REQUEST, load)


def test_weights_of_16_bits_run_in_32_bits(tmp_path: Path) -> None:
    import transformers

    model = tiny_clip()
    full, half = (saved(each, tmp_path / name) for each, name in ((model, "full"), (model.half(), "half")))
    pixels = torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))
    rows = []
    for folder in (full, half):
        tower = load_tower(Pretrained(transformers, str(folder), {"local_files_only": True}), "image")
        assert {values.dtype for values in tower.model.parameters()} == {torch.float32}
        rows.append(tower.features(pixel_values=pixels))
    torch.testing.assert_close(*rows, atol=2e-3, rtol=2e-3)


SPELLINGS = {
    "ViT-B-16/openai": ("ViT-B-16", "openai"), "ViT-B/16/openai": ("ViT-B-16", "openai"),
    "ViT-L/14@336px/openai": ("ViT-L-14-336", "openai"), "ViT-B-16//x/y.pt": ("ViT-B-16", "/x/y.pt"),
    "ViT-H/14-378-quickgelu/dfn5b": ("ViT-H-14-378-quickgelu", "dfn5b"),
    "hf-hub:ORG/NAME": ("hf-hub:ORG/NAME", ""), "RN50/16/x.pt": ("RN50", "16/x.pt"),
}  # fmt: skip


def test_names_of_open_clip() -> None:
    for name, parts in SPELLINGS.items():
        assert _open_clip_parts(ModelRequest("embedder", f"open_clip:{name}", "")) == parts
    for name in ("", "A", "A/", "/b", "ViT-B/16"):
        with refuses():
            load_open_clip(ModelRequest("embedder", f"open_clip:{name}", "do without"), "cpu")
