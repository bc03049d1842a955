"""Models that find texts in a photograph: OWLv2, Grounding DINO and SAM 3 through transformers."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from scoup.base import Registry, ScoupError
from scoup.models.entry import HubEntry, ModelEntry
from scoup.models.hub import ModelRequest, Pretrained, load_pretrained
from scoup.models.normalization import CLIP, HALF, IMAGENET, Normalization
from scoup.scene import Detections

LEAST_SCORE = 0.01  # lower ones are not kept
SAME_BOX, MOST_BOXES = 0.6, 12
"""Of boxes of one text with this intersection over union the best stays; at most so many stay."""
CANDIDATES = 64  # boxes of a text that are looked at
SHORT_SIDE, LONG_SIDE = 800, 1333  # of images for Grounding DINO
SAM3_TOKENS, OWL_TOKENS = 32, 16  # length to which texts are padded
WITHOUT_MODEL = "ask without a model"


class ConceptModel(Protocol):
    """A model that finds texts in a photograph."""

    def to_dict(self) -> dict[str, Any]:
        """Return the settings that decide the result, as plain values."""
        ...

    def detect(self, image: NDArray[np.uint8], texts: Sequence[str]) -> Detections:
        """Detect texts in an image [H, W, 3]."""
        ...


@dataclass(frozen=True, eq=False, kw_only=True)
class _Transformer:
    """A model of transformers with its tokenizer."""

    model: Any
    tokenizer: Any
    name: str
    revision: str
    normalization: Normalization
    known: dict[Any, Any] = field(default_factory=dict)  # texts that were encoded last

    def to_dict(self) -> dict[str, Any]:
        return {"concepts": self.name, "concepts_revision": self.revision}

    def tokens(self, texts: Sequence[str], length: int) -> dict[str, Tensor]:
        options: dict[str, Any] = {"padding": "max_length", "truncation": True, "max_length": length}
        encoded = self.tokenizer(list(texts), return_tensors="pt", **options)
        return {name: encoded[name].to(self.model.device) for name in ("input_ids", "attention_mask")}

    def once(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return the cached value of the last key: all photographs of a scene share one."""
        if key not in self.known:
            self.known.clear()
            self.known[key] = make()
        return self.known[key]

    def pixels(self, image: NDArray[np.uint8], width: int, height: int) -> Tensor:
        """Return an image stretched to a size, as the model takes it, [1, 3, height, width]."""
        from PIL import Image

        scaled = np.array(Image.fromarray(image).resize((width, height), Image.Resampling.BILINEAR))
        values = self.normalization(torch.from_numpy(scaled).permute(2, 0, 1) / 255)
        return values[None].to(self.model.device)


class OwlConcepts(_Transformer):
    """OWLv2: all texts in one pass; images are padded to a square."""

    def detect(self, image: NDArray[np.uint8], texts: Sequence[str]) -> Detections:
        height, width = image.shape[:2]
        whole, side = max(height, width), int(self.model.config.vision_config.image_size)
        square = np.zeros((whole, whole, 3), np.uint8)
        square[:height, :width] = image
        with torch.inference_mode():
            queries = self.once(tuple(texts), lambda: self._queries(texts))
            features, _ = self.model.image_embedder(pixel_values=self.pixels(square, side, side))
            rows = features.flatten(1, 2)
            boxes = self.model.box_predictor(rows, features)[0]
            logits = self.model.class_predictor(rows, queries[None])[0][0]
        scores = logits.sigmoid().cpu().float()
        return best_boxes(corners(boxes.cpu().float()) * whole, scores, (width, height))

    def _queries(self, texts: Sequence[str]) -> Tensor:
        features = self.model.owlv2.get_text_features(**self.tokens(texts, OWL_TOKENS))
        return getattr(features, "pooler_output", features)  # transformers 5 returns an object


class DinoConcepts(_Transformer):
    """Grounding DINO: as many texts in a pass as one caption has room for."""

    def detect(self, image: NDArray[np.uint8], texts: Sequence[str]) -> Detections:
        height, width = image.shape[:2]
        scale = min(SHORT_SIDE / min(height, width), LONG_SIDE / max(height, width))
        pixels = self.pixels(image, max(1, round(width * scale)), max(1, round(height * scale)))
        detections = []
        for first, ids, spans in self._captions(texts):
            tokens = torch.tensor([ids], device=pixels.device)
            with torch.inference_mode():
                masks = {
                    "token_type_ids": torch.zeros_like(tokens),
                    "attention_mask": torch.ones_like(tokens),
                }
                output = self.model(pixel_values=pixels, input_ids=tokens, **masks)
            of_tokens = output.logits[0].sigmoid().cpu().float()
            scores = torch.stack([of_tokens[:, start:end].amax(1) for start, end in spans], 1)
            boxes = corners(output.pred_boxes[0].cpu().float()) * torch.tensor([width, height] * 2)
            of_caption = best_boxes(boxes, scores, (width, height))
            detections.append((of_caption.texts + first, of_caption.scores, of_caption.boxes))
        rows, scores, boxes = (torch.cat(parts) for parts in zip(*detections, strict=True))
        return Detections(rows, scores, boxes, (width, height))

    def _captions(self, texts: Sequence[str]) -> Iterator[tuple[int, list[int], list[tuple[int, int]]]]:
        """Yield captions "[CLS] one . other . [SEP]": position of the first text, ids, and span of each text."""
        start, end = self.tokenizer.cls_token_id, self.tokenizer.sep_token_id
        stop = self.tokenizer.convert_tokens_to_ids(".")
        room = int(self.model.config.max_text_len)
        first, ids, spans = 0, [start], []
        for number, text in enumerate(texts):
            tokens = self.tokenizer(text.lower(), add_special_tokens=False)["input_ids"][: room - 3]
            if spans and len(ids) + len(tokens) + 2 > room:
                yield first, [*ids, end], spans
                first, ids, spans = number, [start], []
            spans.append((len(ids), len(ids) + len(tokens)))
            ids += [*tokens, stop]
        yield first, [*ids, end], spans


class Sam3Concepts(_Transformer):
    """SAM 3: a pass for each text after one for the image, and masks."""

    def detect(self, image: NDArray[np.uint8], texts: Sequence[str]) -> Detections:
        height, width = image.shape[:2]
        side = int(self.model.config.vision_config.backbone_config.image_size)
        detections: list[tuple[Tensor, ...]] = []
        with torch.inference_mode():
            seen = self.model.get_vision_features(self.pixels(image, side, side))
            for number, text in enumerate(texts):
                output = self.model(vision_embeds=seen, **self.tokens([text], SAM3_TOKENS))
                scores = (output.pred_logits[0].sigmoid() * output.presence_logits[0].sigmoid()).cpu().float()
                best = scores.argsort(descending=True)[:MOST_BOXES]
                best = best[scores[best] >= LEAST_SCORE]
                logits = output.pred_masks[0].cpu().float()[best]
                masks = torch.nn.functional.interpolate(logits[:, None], (height, width), mode="bilinear")
                boxes = output.pred_boxes[0].cpu().float()[best].clamp(0, 1)
                boxes = boxes * torch.tensor([width, height] * 2)
                detections.append((torch.full((len(best),), number), scores[best], boxes, masks[:, 0] > 0))
        rows, scores, boxes, masks = (torch.cat(parts) for parts in zip(*detections, strict=True))
        return Detections(rows, scores, boxes, (width, height), masks)


def corners(boxes: Tensor) -> Tensor:
    """Return boxes of centre and size [M, 4] as x0, y0, x1, y1."""
    middle, half = boxes[:, :2], boxes[:, 2:] / 2
    return torch.cat([middle - half, middle + half], 1)


def best_boxes(boxes: Tensor, scores: Tensor, size: tuple[int, int]) -> Detections:
    """Return the best boxes of each text: of those [P, 4] (x0, y0, x1, y1 in pixels) that overlap, the one with the
    largest score [P, Q], in an image of this width and height."""
    boxes = boxes.clamp(min=0).minimum(torch.tensor(size * 2))
    values, places = scores.T.topk(min(CANDIDATES, len(scores)), dim=1)
    rows, indices, areas = [], [], (boxes[:, 2:] - boxes[:, :2]).prod(1)
    for text, (ranked, order) in enumerate(zip(values.tolist(), places, strict=True)):
        waiting = order[: sum(value >= LEAST_SCORE for value in ranked)]
        chosen = 0
        while len(waiting) and chosen < MOST_BOXES:
            best, waiting = int(waiting[0]), waiting[1:]
            rows.append(text)
            indices.append(best)
            chosen += 1
            low = torch.maximum(boxes[best, :2], boxes[waiting, :2])
            both = (torch.minimum(boxes[best, 2:], boxes[waiting, 2:]) - low).clamp(min=0).prod(1)
            waiting = waiting[both <= SAME_BOX * (areas[best] + areas[waiting] - both)]
    texts, chosen_boxes = torch.tensor(rows, dtype=torch.int64), torch.tensor(indices, dtype=torch.int64)
    return Detections(texts, scores[chosen_boxes, texts].float(), boxes[chosen_boxes].float(), size)


_CLASSES = {
    "owlv2": ("Owlv2ForObjectDetection", OwlConcepts, CLIP),
    "grounding-dino": ("GroundingDinoForObjectDetection", DinoConcepts, IMAGENET),
    "sam3": ("Sam3Model", Sam3Concepts, HALF),
}
"""Type in a model's config -> class of transformers, class here, normalisation."""


def open_transformer(
    name: str, revision: str | None = None, device: torch.device | str = "cpu"
) -> ConceptModel:
    """Load a model of transformers: a short name, a folder or a hub id."""
    model_id = CONCEPTS.find(name).model_id(name)

    def load(files: Pretrained) -> ConceptModel:
        kind = files.config.model_type.removesuffix("_video")
        if kind not in _CLASSES:
            raise ScoupError(f"{kind!r} is not a model with words; use one of {', '.join(_CLASSES)}")
        class_name, wrapper, normalization = _CLASSES[kind]
        return wrapper(
            model=files.model(getattr(files.transformers, class_name)).to(device),
            tokenizer=files.tokenizer(),
            name=model_id,
            revision=files.commit,
            normalization=files.normalization() or normalization,
        )

    return load_pretrained(ModelRequest("model with words", name, WITHOUT_MODEL, model_id, revision), load)


def _entry(name: str, hub_id: str, said: str, licence: str = "Apache-2.0") -> ModelEntry:
    file = (hub_id, "model.safetensors")
    return ModelEntry(name, open_transformer, file=file, help=said, licence=licence, extra="models")


CONCEPTS = Registry("model with words", "scoup.concepts", ModelEntry, (
    _entry("owlv2", "google/owlv2-base-patch16-ensemble", "OWLv2 B/16: boxes"),
    _entry("owlv2-large", "google/owlv2-large-patch14-ensemble", "OWLv2 L/14: boxes"),
    _entry("grounding-dino", "IDEA-Research/grounding-dino-tiny", "Grounding DINO, Swin-T: boxes"),
    _entry("grounding-dino-base", "IDEA-Research/grounding-dino-base", "Grounding DINO, Swin-B: boxes"),
    _entry("sam3", "facebook/sam3", "SAM 3: masks", "SAM License"),
    HubEntry("FOLDER or hub id", open_transformer, help="any of these models", extra="models"),
))  # fmt: skip
"""Models that find texts in photographs, by name."""


def open_concepts(name: str, device: torch.device | str = "cpu") -> ConceptModel:
    """Open an open-vocabulary detector, by a name of ``CONCEPTS``.

    Raises:
        UnknownNameError, ScoupError: there is no such model, or it cannot be loaded.

    Example:
        >>> from scoup.models.concepts import CONCEPTS
        >>> CONCEPTS["owlv2"].licence
        'Apache-2.0'
    """
    return CONCEPTS.find(name).open(name, None, device)
