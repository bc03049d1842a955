"""SAM of three generations and models that take words: real classes with tiny random weights, also fed by hand."""

from __future__ import annotations

from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image
from torch.nn import functional

import tiny_models
from mask_samples import smooth_image
from messages import refuses
from scoup.base import ScoupError, UnknownNameError
from scoup.models import concepts
from scoup.models.concepts import LEAST_SCORE, MOST_BOXES, SAME_BOX, best_boxes, open_concepts
from scoup.models.normalization import CLIP, HALF, IMAGENET, Normalization
from scoup.models.sam import open_sam
from scoup.uplift.naming import box_ious
from tiny_models import TINY_SAMS, TINY_WORDS, save_grounding_dino, save_owl, save_sam3_concepts, saved

SIZES = [(48, 60), (90, 40), (64, 64), (33, 7)]
POINTS = torch.tensor([[5.5, 5.0], [3.0, 20.25], [6.0, 31.0]], dtype=torch.float64)


def pixels_by_hand(image: np.ndarray, width: int, height: int, normalization: Normalization) -> torch.Tensor:
    scaled = np.array(Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR))
    values = (scaled / 255 - normalization.mean) / normalization.std
    return torch.from_numpy(values).float().permute(2, 0, 1)[None]


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
    pixels = torch.zeros(1, 3, side, side)
    pixels[..., :high, :wide] = pixels_by_hand(image, wide, high, HALF if kind == "sam3" else IMAGENET)
    points = POINTS * torch.tensor([wide / width, high / height])
    with torch.inference_mode():
        answer = model(
            pixel_values=pixels,
            input_points=points.float()[None, :, None],
            input_labels=torch.ones(1, len(points), 1, dtype=torch.int32),
            multimask_output=True,
        )
    masks = answer.pred_masks[0]
    whole = functional.interpolate(masks, (side, side), mode="bilinear") if kind == "sam" else masks
    large = functional.interpolate(whole[..., :high, :wide], size, mode="bilinear")
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
    video = tiny_models.tiny_sam2_video()
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
    logits = encoded.predict(POINTS)[0].flatten(0, 1)
    height = logits.shape[1] // 2 if kind == "sam" else logits.shape[1]
    assert torch.equal(encoded.without_padding(logits), logits[:, :height])


def test_normalization_comes_with_the_model(tmp_path: Path) -> None:
    given: dict[str, dict[str, Any]] = {
        "usual": {},
        "own": {"image_mean": [0.1, 0.2, 0.3], "image_std": [1, 1, 1]},
    }
    folders = (saved(TINY_SAMS["sam"](), tmp_path / name, **values) for name, values in given.items())
    usual, own = (open_sam(str(folder)).encode(smooth_image(20, 30)).predict(POINTS)[0] for folder in folders)
    assert not torch.allclose(usual, own, atol=1e-3)


def test_pickled_weights_are_refused(tmp_path: Path) -> None:
    folder = saved(TINY_SAMS["sam"](), tmp_path / "pickled")
    (folder / "model.safetensors").unlink()
    torch.save(TINY_SAMS["sam"]().state_dict(), folder / "pytorch_model.bin")
    if int(version("transformers").split(".")[0]) >= 5:  # older ones read it, and of pickles the weights only
        with pytest.raises(ScoupError, match="cannot be loaded"):
            open_sam(str(folder))


TEXTS = ("red apple", "chair", "lamp")
HEIGHT, WIDTH = 40, 60


def ids_of(text: str, length: int, padding: int) -> tuple[list[int], list[int]]:
    ids = [1, *(2 + TINY_WORDS.index(word) for word in text.split()), 6]
    return ids + [padding] * (length - len(ids)), [1] * len(ids) + [0] * (length - len(ids))


def owl_by_hand(model: Any, image: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    square = np.zeros((WIDTH, WIDTH, 3), np.uint8)
    square[:HEIGHT] = image
    rows = [ids_of(text, 16, 6) for text in TEXTS]
    output = model(
        input_ids=torch.tensor([ids for ids, _ in rows]),
        attention_mask=torch.tensor([mask for _, mask in rows]),
        pixel_values=pixels_by_hand(square, 48, 48, CLIP),
    )
    return output.pred_boxes[0] * WIDTH, output.logits[0].sigmoid()


def dino_by_hand(model: Any, image: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
    """All three texts fit into one caption of 12: [CLS] red apple . chair . lamp . [SEP]."""
    ids = torch.tensor([[101, 1, 2, 1012, 3, 1012, 4, 1012, 102]])
    pixels = pixels_by_hand(image, 1200, 800, IMAGENET)
    output = model(pixel_values=pixels, input_ids=ids, attention_mask=torch.ones_like(ids))
    scores = output.logits[0].sigmoid()
    boxes = output.pred_boxes[0] * torch.tensor([WIDTH, HEIGHT, WIDTH, HEIGHT])
    return boxes, torch.stack([scores[:, 1:3].amax(1), scores[:, 4], scores[:, 6]], 1)


@pytest.mark.parametrize(("save", "by_hand"), [(save_owl, owl_by_hand), (save_grounding_dino, dino_by_hand)])
def test_boxes_are_those_of_the_model_fed_by_hand(save: Any, by_hand: Any, tmp_path: Path) -> None:
    model, image = save(tmp_path), smooth_image(HEIGHT, WIDTH)
    found = open_concepts(str(tmp_path)).detect(image, TEXTS)
    with torch.inference_mode():
        boxes, scores = by_hand(model, image)
    middle, half = boxes[:, :2], boxes[:, 2:] / 2
    wanted = torch.cat([middle - half, middle + half], 1).clamp(min=0)
    wanted = wanted.minimum(torch.tensor([WIDTH, HEIGHT] * 2))
    assert found.size == (WIDTH, HEIGHT)
    assert set(found.texts.tolist()) == {0, 1, 2}
    for text in range(3):
        best = int(scores[:, text].argmax())
        first = int((found.texts == text).nonzero()[0])
        torch.testing.assert_close(found.scores[first], scores[best, text], atol=2e-4, rtol=0)
        torch.testing.assert_close(found.boxes[first], wanted[best], atol=0.05, rtol=0)


def test_many_texts_take_several_captions(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(concepts, "SHORT_SIDE", 400)  # a quarter of the pixels
    save_grounding_dino(tmp_path)
    model, image = open_concepts(str(tmp_path)), smooth_image(HEIGHT, WIDTH)
    texts = ("red apple", "chair", "lamp", "apple", "red chair")  # 15 ids with the stops
    found = model.detect(image, texts)
    assert set(found.texts.tolist()) == set(range(5))
    alone = model.detect(image, texts[4:])
    mine = found.texts == 4
    torch.testing.assert_close(found.scores[mine], alone.scores, atol=1e-5, rtol=0)


def test_masks_of_sam3_are_those_of_the_model_fed_by_hand(tmp_path: Path) -> None:
    model, image = save_sam3_concepts(tmp_path), smooth_image(HEIGHT, WIDTH)
    found = open_concepts(str(tmp_path)).detect(image, TEXTS)
    assert found.masks is not None
    assert found.masks.shape == (len(found.scores), HEIGHT, WIDTH)
    for number, text in enumerate(TEXTS):
        ids, mask = ids_of(text, 32, 6)
        with torch.inference_mode():
            output = model(
                pixel_values=pixels_by_hand(image, 56, 56, HALF),
                input_ids=torch.tensor([ids]),
                attention_mask=torch.tensor([mask]),
            )
        scores = output.pred_logits[0].sigmoid() * output.presence_logits[0].sigmoid()
        best, first = int(scores.argmax()), int((found.texts == number).nonzero()[0])
        assert float(found.scores[first]) == pytest.approx(float(scores[best]), abs=2e-4)
        logits = torch.nn.functional.interpolate(
            output.pred_masks[:, best, None], (HEIGHT, WIDTH), mode="bilinear"
        )
        assert float((found.masks[first] == (logits[0, 0] > 0)).float().mean()) > 0.99


def test_of_overlapping_boxes_the_best_stays() -> None:
    rng = np.random.default_rng(0)
    low = torch.from_numpy(rng.random((50, 2)) * 60).float()
    boxes = torch.cat([low, low + torch.from_numpy(rng.random((50, 2)) * 40).float() + 5], 1)
    scores = torch.from_numpy(rng.random((50, 2))).float() * torch.tensor([1.0, 0.02])
    found = best_boxes(boxes, scores, (80, 80))
    for text in range(2):
        mine = found.boxes[found.texts == text]
        values = found.scores[found.texts == text]
        assert 0 < len(mine) <= MOST_BOXES
        assert bool((values >= LEAST_SCORE).all())
        assert values.tolist() == sorted(values.tolist(), reverse=True)
        assert float(values[0]) == float(scores[:, text].max())
        assert float((box_ious(mine, mine) - torch.eye(len(mine))).max()) <= SAME_BOX + 1e-6
    assert float(found.boxes.max()) <= 80


def test_a_name_that_is_not_known_is_refused() -> None:
    with refuses(UnknownNameError):
        open_concepts("owl")
