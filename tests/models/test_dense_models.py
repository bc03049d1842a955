"""Dense encoders: real loading of tiny random models, against the formulas through transformers' own modules."""

from __future__ import annotations

from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.nn import functional

from scoup.base import ScoupError
from scoup.models.dense import DenseModel, open_dense_model
from scoup.models.image import open_image_model
from scoup.models.normalization import CLIP, HALF
from scoup.models.windows import _starts
from tiny_models import saved, tiny_clip, tiny_sam, tiny_siglip, tiny_siglip2, tiny_tips

SIDE, PATCH, GRID = 32, 8, 4


@pytest.fixture(scope="module")
def opened(tmp_path_factory) -> dict[str, DenseModel]:
    models = {"clip": tiny_clip, "siglip": tiny_siglip, "tips": tiny_tips}
    return {
        kind: open_dense_model(f"dense:{saved(build(), tmp_path_factory.mktemp(kind))}")
        for kind, build in models.items()
    }


def photograph(height: int = SIDE, width: int = SIDE, seed: int = 0) -> Tensor:
    return torch.rand(3, height, width, generator=torch.Generator().manual_seed(seed))


@torch.inference_mode()
def test_clip_is_the_value_path_of_its_last_layer(opened: dict[str, DenseModel]) -> None:
    model, image = tiny_clip(), photograph()
    states = model.vision_model(CLIP(image)[None], output_hidden_states=True).hidden_states
    last = model.vision_model.encoder.layers[-1]
    values = functional.linear(
        last.layer_norm1(states[-2]), last.self_attn.v_proj.weight, last.self_attn.v_proj.bias
    )
    out = last.self_attn.out_proj(values)
    wanted = model.visual_projection(model.vision_model.post_layernorm(out))[0, 1:]
    wanted = functional.normalize(wanted, dim=1).view(GRID, GRID, -1)
    tokens = opened["clip"].tokens(image)
    torch.testing.assert_close(tokens, wanted, atol=1e-5, rtol=1e-5)
    assert tokens.shape[2] == opened["clip"].dim == 12
    shares = torch.zeros(2, GRID, GRID)
    shares[0, 1, 2], shares[1, 0, 0], shares[1, 3, 3] = 0.25, 0.5, 1.0
    vectors = opened["clip"].pool(tokens, shares)
    mixed = functional.normalize(0.5 * tokens[0, 0] + tokens[3, 3], dim=0)
    torch.testing.assert_close(vectors, torch.stack([tokens[1, 2], mixed]), atol=1e-5, rtol=1e-5)


@torch.inference_mode()
def test_tips_is_the_last_layer_with_its_values_in_place_of_attention(opened: dict[str, DenseModel]) -> None:
    vision, image, inputs = tiny_tips().vision_model, photograph(), []
    last = vision.encoder.layer[-1]
    last.register_forward_pre_hook(lambda module, given: inputs.append(given[0]))
    vision(pixel_values=image[None])  # not normalised
    mixed = []
    for state in inputs[0][0, 3:]:  # without the class and two register tokens
        value = functional.linear(last.norm1(state), last.attention.v_proj.weight, last.attention.v_proj.bias)
        state = state + 0.7 * functional.linear(
            value, last.attention.o_proj.weight, last.attention.o_proj.bias
        )
        hidden = functional.gelu(functional.linear(last.norm2(state), last.mlp.fc1.weight, last.mlp.fc1.bias))
        mixed.append(state + 0.7 * functional.linear(hidden, last.mlp.fc2.weight, last.mlp.fc2.bias))
    wanted = functional.normalize(vision.layernorm(torch.stack(mixed)), dim=1).view(GRID, GRID, -1)
    tokens = opened["tips"].tokens(image)
    torch.testing.assert_close(tokens, wanted, atol=1e-5, rtol=1e-5)
    shares = torch.zeros(1, GRID, GRID)
    shares[0, 0, 0], shares[0, 3, 3] = 0.5, 1.0
    mean = functional.normalize(0.5 * wanted[0, 0] + wanted[3, 3], dim=0)
    torch.testing.assert_close(opened["tips"].pool(tokens, shares)[0], mean, atol=1e-5, rtol=1e-5)


@torch.inference_mode()
def test_naflex_reads_patches_row_by_row(tmp_path: Path) -> None:
    model, crop = tiny_siglip2(), (photograph() * 255).byte()
    image = crop / 255
    folder = str(saved(model, tmp_path))
    pixels = HALF(image)
    patches = [
        pixels[:, y : y + PATCH, x : x + PATCH].permute(1, 2, 0).flatten()
        for y in range(0, SIDE, PATCH)
        for x in range(0, SIDE, PATCH)
    ]
    features = model.get_image_features(
        pixel_values=torch.stack(patches)[None],
        pixel_attention_mask=torch.ones(1, GRID**2),
        spatial_shapes=torch.tensor([[GRID, GRID]]),
    )
    wanted = functional.normalize(features.pooler_output, dim=1)
    dense = open_dense_model(f"dense:{folder}")
    found = dense.pool(dense.tokens(image), torch.ones(1, GRID, GRID))
    torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)
    crops = open_image_model(folder)
    assert (crops.side, dense.side) == (SIDE, SIDE)
    torch.testing.assert_close(crops.embed(crop.permute(1, 2, 0)[None]), wanted, atol=1e-5, rtol=1e-5)


@torch.inference_mode()
def test_siglips_head_attends_to_the_region_alone(opened: dict[str, DenseModel]) -> None:
    head = tiny_siglip().vision_model.head
    tokens = opened["siglip"].tokens(photograph())
    shares = (torch.rand(5, GRID, GRID, generator=torch.Generator().manual_seed(1)) > 0.6).float()
    shares[4] = 1
    flat = tokens.flatten(0, 1)[None]
    for number, share in enumerate(shares):
        mixed = head.attention(head.probe, flat, flat, key_padding_mask=share.flatten()[None] == 0)[0]
        wanted = functional.normalize((mixed + head.mlp(head.layernorm(mixed)))[0, 0], dim=0)
        found = opened["siglip"].pool(tokens, 0.3 * shares[number : number + 1])[0]  # alike everywhere
        torch.testing.assert_close(found, wanted, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("kind", ["clip", "siglip", "tips"])
def test_windows_cover_a_photograph_and_are_averaged_where_they_overlap(kind: str, opened) -> None:
    model, image = opened[kind], photograph(SIDE, 48)  # windows begin at columns 0 and 2
    tokens = model.tokens(image)
    assert tokens.shape[:2] == (4, 6)
    first, second = model.tokens(image[..., :32]), model.tokens(image[..., 16:])
    mean = (first[:, 2:] + second[:, :2]) / 2
    if kind != "siglip":
        mean = functional.normalize(mean, dim=2)
    torch.testing.assert_close(tokens[:, :2], first[:, :2], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(tokens[:, 4:], second[:, 2:], atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(tokens[:, 2:4], mean, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize(("length", "window"), [(4, 4), (5, 4), (8, 4), (9, 4), (31, 7)])
def test_as_few_windows_as_cover_a_length(length: int, window: int) -> None:
    starts = _starts(length, window)
    assert len(starts) == -(-length // window)
    covered = {place for start in starts for place in range(start, start + window)}
    assert covered == set(range(length))


def test_other_models_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ScoupError, match="no image features; use CLIP, SigLIP or TIPSv2"):
        open_dense_model(f"dense:{saved(tiny_sam(), tmp_path)}")
    with pytest.raises(ScoupError, match="embedder 'dense:nobody/nothing' cannot be loaded"):
        open_dense_model("dense:nobody/nothing")


def test_a_package_that_is_too_old_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import transformers

    def unknown(*given: object, **options: object) -> None:
        raise ValueError("the checkpoint has model type `tipsv2`, which is not recognised")

    folder = saved(tiny_tips(), tmp_path)
    monkeypatch.setattr(transformers.AutoConfig, "from_pretrained", unknown)
    monkeypatch.setattr(transformers, "__version__", "4.40.0")
    needed = (
        r"tipsv2 models need transformers 5.14 or newer \(this is 4.40.0\); run 'pip install -U transformers'"
    )
    with pytest.raises(ScoupError, match=needed):
        open_dense_model(f"dense:{folder}")
