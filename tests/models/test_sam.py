"""SAM of three generations: real loading and forward passes of tiny random models, fed by hand for comparison."""

from __future__ import annotations

import sys
from importlib.metadata import version
from pathlib import Path

import numpy as np
import pytest
import torch
from torch.nn import functional

from mask_samples import smooth_image
from scoup.base import ScoupError
from scoup.models.sam import open_sam
from tiny_models import TINY_SAMS, saved, tiny_clip, tiny_sam, tiny_sam2, tiny_sam2_video

SIZES = [(48, 60), (90, 40), (64, 64), (33, 7)]
POINTS = torch.tensor([[5.5, 5.0], [3.0, 20.25], [6.0, 31.0]], dtype=torch.float64)


@pytest.fixture(scope="module", params=list(TINY_SAMS))
def loaded(request, tmp_path_factory):
    """Kind, the model as built, and the same after a round trip through files."""
    model = TINY_SAMS[request.param]()
    folder = saved(model, tmp_path_factory.mktemp(request.param))
    return request.param, model, open_sam(str(folder))


@pytest.mark.parametrize("size", SIZES)
def test_answers_are_those_of_the_model_fed_by_hand(loaded, size) -> None:
    """Preprocessing, points and enlargement written out anew, through ``forward`` with pixels."""
    kind, model, opened = loaded
    image = smooth_image(*size)
    side = 56 if kind == "sam3" else 64
    height, width = size
    if kind == "sam":
        longer = max(size)
        high, wide = int(height * side / longer + 0.5), int(width * side / longer + 0.5)
    else:
        high = wide = side
    from PIL import Image

    scaled = np.asarray(Image.fromarray(image).resize((wide, high), Image.Resampling.BILINEAR))
    mean, std = (
        (0.5, 0.5) if kind == "sam3" else (np.array([0.485, 0.456, 0.406]), np.array([0.229, 0.224, 0.225]))
    )
    pixels = np.zeros((side, side, 3))
    pixels[:high, :wide] = (scaled / 255 - mean) / std
    points = POINTS * torch.tensor([wide / width, high / height])
    with torch.inference_mode():
        answer = model(
            pixel_values=torch.from_numpy(pixels).float().permute(2, 0, 1)[None],
            input_points=points.float()[None, :, None],
            input_labels=torch.ones(1, len(points), 1, dtype=torch.int32),
            multimask_output=True,
        )
    masks = answer.pred_masks[0]
    if kind == "sam":
        whole = functional.interpolate(masks, (side, side), mode="bilinear", align_corners=False)
        large = functional.interpolate(whole[..., :high, :wide], size, mode="bilinear", align_corners=False)
    else:
        large = functional.interpolate(masks, size, mode="bilinear", align_corners=False)
    encoded = opened.encode(image)
    logits, iou = encoded.predict(POINTS)
    assert logits.shape == masks.shape
    shown, wanted = (encoded.without_padding(item.flatten(0, 1)) for item in (logits, masks))
    torch.testing.assert_close(shown, wanted, atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(iou, answer.iou_scores[0], atol=1e-4, rtol=1e-4)
    torch.testing.assert_close(
        encoded.upscale(logits.flatten(0, 1)), large.flatten(0, 1), atol=1e-4, rtol=1e-4
    )
    assert logits.std() > 0.05, "the tiny model answers all alike: the comparison would say nothing"
    assert not torch.equal(logits[0], logits[1])


def test_video_models_are_used_as_image_models(tmp_path: Path) -> None:
    video = tiny_sam2_video()
    opened = open_sam(str(saved(video, tmp_path)))
    weights = dict(video.named_parameters())
    own = dict(opened.model.named_parameters())
    assert len(own) > 100
    assert all(torch.equal(value, weights[name]) for name, value in own.items())
    logits, _ = opened.encode(smooth_image(40, 50)).predict(POINTS)
    assert logits.shape == (3, 3, 16, 16)


def test_trimmed_masks_show_the_image_alone(loaded) -> None:
    kind, _, opened = loaded
    encoded = opened.encode(smooth_image(30, 60))
    logits, _ = encoded.predict(POINTS)
    trimmed = encoded.without_padding(logits.flatten(0, 1))
    height, width = logits.shape[-2:]
    assert tuple(trimmed.shape[-2:]) == ((height // 2, width) if kind == "sam" else (height, width))
    assert torch.equal(trimmed, logits.flatten(0, 1)[:, : trimmed.shape[1], : trimmed.shape[2]])


def test_normalization_comes_with_the_model(tmp_path: Path) -> None:
    image = smooth_image(20, 30)
    plain = open_sam(str(saved(tiny_sam(), tmp_path / "plain")))
    logits = plain.encode(image).predict(POINTS)[0]
    usual = [0.485, 0.456, 0.406], [0.229, 0.224, 0.225]
    for name, (mean, std) in {"same": usual, "other": ([0.1, 0.2, 0.3], [1, 1, 1])}.items():
        named = open_sam(str(saved(tiny_sam(), tmp_path / name, image_mean=mean, image_std=std)))
        found = named.encode(image).predict(POINTS)[0]
        assert torch.allclose(found, logits, atol=1e-3) == (name == "same")


def test_what_cannot_be_loaded_is_told(tmp_path: Path, monkeypatch) -> None:
    with pytest.raises(ScoupError, match=r"segmenter 'sam-vit-h' cannot be loaded: .*felzenszwalb"):
        open_sam("sam-vit-h")
    with pytest.raises(ScoupError, match="'clip' is not a SAM model"):
        open_sam(str(saved(tiny_clip(), tmp_path / "clip")))
    folder = saved(tiny_sam(), tmp_path / "pickled")
    (folder / "model.safetensors").unlink()
    torch.save(tiny_sam().state_dict(), folder / "pytorch_model.bin")
    if int(version("transformers").split(".")[0]) >= 5:  # older ones read it, and of pickles the weights only
        with pytest.raises(ScoupError, match="cannot be loaded"):
            open_sam(str(folder))
    newer = str(saved(tiny_sam2(), tmp_path / "sam2"))
    monkeypatch.setattr(sys.modules["transformers"], "Sam2Model", None)  # an older transformers
    with pytest.raises(ScoupError, match="has no sam2"):
        open_sam(newer)
