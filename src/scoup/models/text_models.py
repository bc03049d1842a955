"""The text halves of embedders."""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from scoup.base import Registry, ScoupError, ScoupWarning, counted
from scoup.models.entry import Device, HubEntry, ModelEntry, Texts
from scoup.models.hub import (
    OPEN_CLIP,
    ModelRequest,
    load_open_clip,
    load_pretrained,
    open_clip_identity,
)
from scoup.models.image import open_clip_image_model, open_image_model
from scoup.models.towers import load_tower

GROUP = "scoup.embedders"  # of the entry points
_ALTERNATIVE = "use a table file of words, which scoup words makes on a machine that has the model"


def open_text_model(name: str, revision: str | None, device: Device) -> Texts:
    """Open the text half of an embedder, by the name that regions record."""
    entry = TEXT_MODELS.find(name)
    if entry.texts is None:
        raise ScoupError(
            f"{name}: this image encoder has no text model; pass a table of the vectors of words"
        )
    return entry.texts(name, revision, device)


def _open_clip_texts(name: str, revision: str | None, device: Device) -> Texts:
    request = ModelRequest("text model", name, _ALTERNATIVE, revision=revision)
    identity = open_clip_identity(request)
    model, tokenizer = load_open_clip(request, device, with_tokenizer=True)

    def encode(phrases: list[str]) -> Tensor:
        with torch.inference_mode():
            return model.encode_text(tokenizer(phrases).to(device)).clone()

    return encode, identity


def _pretrained_texts(name: str, revision: str | None, device: Device) -> Texts:
    request = ModelRequest("text model", name, _ALTERNATIVE, revision=revision)
    identity, tower, tokenizer = load_pretrained(
        request, lambda files: (files.identity(), load_tower(files, "text"), files.tokenizer())
    )
    tower.model.to(device)
    limit = int(tower.config.max_position_embeddings)
    # SigLIP attends to padding, for it was trained at full length and without a mask; CLIP and TIPS do not.
    padding, wanted = "longest", ("input_ids", "attention_mask")
    if tower.kind in ("siglip", "naflex"):
        padding, wanted = "max_length", ("input_ids",)

    def encode(phrases: list[str]) -> Tensor:
        _warn_of_long(phrases, [len(ids) for ids in tokenizer(phrases)["input_ids"]], limit)
        tokens = tokenizer(phrases, padding=padding, truncation=True, max_length=limit, return_tensors="pt")
        return tower.features(**{key: tokens[key].to(device) for key in wanted if key in tokens})

    return encode, identity


def _warn_of_long(phrases: list[str], lengths: list[int], limit: int) -> None:
    for phrase, length in zip(phrases, lengths, strict=True):
        if length > limit:
            warnings.warn(
                f"the phrase {phrase[:40]!r} has {counted(length, 'token')}, the text model reads only {limit}: "
                "the rest is ignored",
                ScoupWarning,
                stacklevel=4,
            )


HUB = HubEntry(
    "FOLDER or hub id", open_image_model, _pretrained_texts, extra="models",
    help="any CLIP, SigLIP or TIPSv2 of transformers",
)  # fmt: skip
ANY_OPEN_CLIP = ModelEntry(
    f"{OPEN_CLIP}ARCHITECTURE/PRETRAINED", open_clip_image_model, _open_clip_texts, extra="open-clip",
    help="any model of open_clip",
)  # fmt: skip
TEXT_MODELS = Registry("text model or table file", GROUP, ModelEntry, (HUB, ANY_OPEN_CLIP))
