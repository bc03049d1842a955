"""Embedders by name, and their text halves."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch
from torch import Tensor

from scoup.base import Registry, ScoupError, ScoupWarning, counted
from scoup.models.entry import DENSE_PREFIX, Device, HubEntry, ModelEntry, Texts
from scoup.models.hub import OPEN_CLIP, ModelRequest, load_open_clip, load_pretrained, open_clip_identity
from scoup.models.image import open_clip_image_model, open_image_model
from scoup.models.plain_colors import PLAIN_COLORS
from scoup.models.towers import load_tower

_GROUP = "scoup.embedders"  # of the entry points
_CLIP = "laion/CLIP-ViT-B-16-laion2B-s34B-b88K"
_NAFLEX = "google/siglip2-base-patch16-naflex"
_TIPS = "google/tipsv2-b14"
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


_HUB = HubEntry(
    "FOLDER or hub id", open_image_model, _pretrained_texts, extra="models",
    help="any CLIP, SigLIP or TIPSv2 of transformers",
)  # fmt: skip
_ANY_OPEN_CLIP = ModelEntry(
    f"{OPEN_CLIP}ARCHITECTURE/PRETRAINED", open_clip_image_model, _open_clip_texts, extra="open-clip",
    help="any model of open_clip",
)  # fmt: skip
TEXT_MODELS = Registry("text model or table file", _GROUP, ModelEntry, (_HUB, _ANY_OPEN_CLIP))


def embedder_table(open_dense: Callable[..., Any]) -> Registry[ModelEntry]:
    """Return the table of embedders: models of images, the same ones run densely by ``open_dense``, and no model."""
    return Registry("embedder", _GROUP, ModelEntry, (
        ModelEntry(
            _CLIP, open_image_model, size="598 MB", seconds=47.6, file=(_CLIP, "model.safetensors"),
            help="CLIP ViT-B/16, as LangSplat: the default", licence="MIT", extra="models",
        ),
        ModelEntry(
            f"{DENSE_PREFIX}{_TIPS}", open_dense, size="784 MB", file=(_TIPS, "model.safetensors"),
            help="TIPSv2 B/14: patches aligned with text; l14, so400m14, g14 are larger",
            licence="Apache-2.0, CC-BY-4.0", extra="models",
        ),
        ModelEntry(
            _NAFLEX, open_image_model, size="1.5 GB", file=(_NAFLEX, "model.safetensors"),
            help="SigLIP 2 NaFlex, on squares of 256 patches", licence="Apache-2.0", extra="models",
        ),
        _HUB,
        ModelEntry(
            f"{DENSE_PREFIX}MODEL", open_dense, seconds=2.4, extra="models",
            help="the same models in one pass per photograph instead of one per region",
        ),
        replace(
            _ANY_OPEN_CLIP, name=f"{OPEN_CLIP}MobileCLIP2-S2/dfndr2b", size="398 MB",
            licence="Apple AMLR (research)", help="MobileCLIP2 S2: small and fast; S0, B, S3, S4, too",
        ),
        replace(
            _ANY_OPEN_CLIP, name=f"{OPEN_CLIP}PE-Core-B-16/meta", size="1.7 GB", licence="Apache-2.0",
            help="Perception Encoder B/16; PE-Core-L-14-336, PE-Core-bigG-14-448 are larger",
        ),
        _ANY_OPEN_CLIP,
        PLAIN_COLORS,
    ))  # fmt: skip
