"""Models that do not load: what they are, and what to use, in our words."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch

from messages import refuses
from scoup.base import ScoupError
from scoup.models import hub
from scoup.models.hub import ModelRequest, Pretrained, _open_clip_parts, load_pretrained
from scoup.models.image import open_image_model
from scoup.models.sam import open_sam
from scoup.models.towers import load_tower
from tiny_models import saved, tiny_clip

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
    weights = {name: torch.zeros(shape) for name, shape in PUBLISHED[file].items()}
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
        {"config.json": "{}"}, {"config.json": "{"}, {"config.json": None},
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
        load_pretrained(ModelRequest("embedder", "some/model", "do without"), load)


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


@pytest.mark.parametrize(("name", "parts"), [
    ("ViT-B-16/openai", ("ViT-B-16", "openai")), ("ViT-B/16/openai", ("ViT-B-16", "openai")),
    ("ViT-L/14@336px/openai", ("ViT-L-14-336", "openai")), ("ViT-B-16//x/y.pt", ("ViT-B-16", "/x/y.pt")),
    ("ViT-H/14-378-quickgelu/dfn5b", ("ViT-H-14-378-quickgelu", "dfn5b")),
    ("hf-hub:ORG/NAME", ("hf-hub:ORG/NAME", "")), ("RN50/16/x.pt", ("RN50", "16/x.pt")),
])  # fmt: skip
def test_spellings_of_open_clip(name: str, parts: tuple[str, str]) -> None:
    assert _open_clip_parts(ModelRequest("embedder", f"open_clip:{name}", "")) == parts
    with refuses():
        _open_clip_parts(ModelRequest("embedder", "open_clip:ViT-B/16", ""))
