"""Words to unit vectors: CLIP text models, or a table file of name -> vector for work without a model."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any

import torch
from torch import Tensor

from scoup.base.errors import InputError, ScoupError, ScoupWarning, UnknownNameError
from scoup.models.hub import OPEN_CLIP, first_line, load_local_first, open_clip_names
from scoup.models.word_table import EmbeddingTable, is_table, load_table, save_table
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, with_everyday

__all__ = ["TextEncoder", "save_table"]

COLORS = "colors"
"""Name of embeddings made without a model (``extract.plain_colors``): no words have a place among them."""
_BATCH = 64

Encode = Callable[[list[str]], Tensor]


class TextEncoder:
    """Turns phrases into unit vectors, with ``TextEncoder.open``; usable as a context manager.

    Phrases are encoded as they stand, without a prompt template.

    Attributes:
        name: id of the embedding model, "" if a table does not name it. A field answers only to vectors of
            the model its regions were encoded with.
        dim: D, the size of a vector.
        table_names: what a table holds, None for a model, which takes any phrase.
    """

    def __init__(
        self, name: str, dim: int, encode: Encode, table_names: tuple[str, ...] | None = None
    ) -> None:
        self.name = name
        self.dim = dim
        self.table_names = table_names
        self._encode: Encode | None = encode

    @classmethod
    def open(
        cls, model_or_table: str | Path, revision: str | None = None, device: torch.device | str = "cpu"
    ) -> TextEncoder:
        """A text encoder of a table file or a CLIP model.

        Args:
            model_or_table: a table file (.npz, .json, .safetensors; see ``scoup.models.word_table.load_table``), or
                a model: a folder or hub id that transformers knows, such as
                "laion/CLIP-ViT-B-16-laion2B-s34B-b88K" (CLIP and SigLIP kinds), or
                "open_clip:ARCHITECTURE/PRETRAINED", such as "open_clip:ViT-B-16/laion2b_s34b_b88k". A name
                ending like a table is always taken as a file.
            revision: branch, tag or commit of a hub model.
            device: where the model runs. Vectors always come back on the CPU.

        Raises:
            MissingFileError, FileFormatError: the table is missing or damaged.
            ScoupError: the package or the weights that the model needs are not there.
        """
        text = str(model_or_table)
        if is_table(text):
            return cls._of_table(load_table(text))
        if text == COLORS:
            raise ScoupError(
                "these regions were embedded by their colours, without a model, and answer to no words; extract them "
                "with a CLIP model (scoup extract --embedder MODEL) and build the field again"
            )
        if text.startswith(OPEN_CLIP):
            return cls(text, *_open_open_clip(text, device))
        return cls(text, *_open_transformers(text, revision, device))

    @classmethod
    def _of_table(cls, table: EmbeddingTable) -> TextEncoder:
        vectors = torch.from_numpy(table.vectors)
        exact = {name: row for row, name in reversed(list(enumerate(table.names)))}
        folded = {name.strip().casefold(): row for row, name in reversed(list(enumerate(table.names)))}

        def encode(phrases: list[str]) -> Tensor:
            rows = []
            for phrase in phrases:
                row = exact.get(phrase, folded.get(phrase.strip().casefold()))
                if row is None:
                    raise UnknownNameError("text embedding", phrase, table.names, str(table.path))
                rows.append(row)
            return vectors[rows]

        return cls(table.model, vectors.shape[1], encode, table.names)

    def encode(self, phrases: Sequence[str]) -> Tensor:
        """[Q, D] float32 unit vectors of the phrases, on the CPU.

        Raises:
            UnknownNameError: a table lacks a phrase (case and outer blanks are ignored if need be); the
                message lists the nearest names.
            InputError: the encoder is closed, or a phrase is not text or is blank.
        """
        if self._encode is None:
            raise InputError("this text encoder is closed; open it again")
        if isinstance(phrases, str):
            raise InputError(f"give a list of phrases, such as [{phrases!r}], not one string")
        for phrase in phrases:
            if not isinstance(phrase, str) or not phrase.strip():
                raise InputError(f"a phrase to encode must be a text that is not blank, got {phrase!r}")
        if not phrases:
            return torch.zeros(0, self.dim)
        batches = [
            self._encode(list(phrases[start : start + _BATCH])) for start in range(0, len(phrases), _BATCH)
        ]
        vectors = torch.cat(batches).float().cpu()
        return torch.nn.functional.normalize(vectors, dim=1)

    def canonical(self, everyday: bool = False) -> Tensor:
        """[4, D] float32 unit vectors of the canonical phrases (``scoup.models.words.CANONICAL_PHRASES``).

        Args:
            everyday: add the mean of everyday words as a fifth row (``scoup.models.words.with_everyday``), as
                `scoup query` does. The papers' protocols know no such row.

        Raises:
            UnknownNameError: a table lacks a phrase.
        """
        phrases = self.encode(CANONICAL_PHRASES)
        return with_everyday(phrases, self.everyday()) if everyday else phrases

    def everyday(self) -> Tensor:
        """[B, D] float32 unit vectors of everyday words (``scoup.models.words``).

        Of a model those of a fixed list, of a table all its names but the canonical phrases.
        """
        if self.table_names is None:
            return self.encode(EVERYDAY_WORDS)
        phrases = {phrase.casefold() for phrase in CANONICAL_PHRASES}
        return self.encode([name for name in self.table_names if name.strip().casefold() not in phrases])

    def close(self) -> None:
        """Let go of the model or table."""
        self._encode = None

    def __enter__(self) -> TextEncoder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _open_transformers(model_id: str, revision: str | None, device: torch.device | str) -> tuple[int, Encode]:
    try:
        import transformers
    except ImportError as error:
        raise ScoupError(
            f"text model {model_id!r} needs the package transformers: pip install 'scoup[models]', "
            "or use a table file of text embeddings"
        ) from error
    with_reason = f"text model {model_id!r} cannot be loaded"
    try:
        loaded = load_local_first(partial(_load_transformers, transformers, model_id), model_id, revision)
    except Exception as error:  # hub, network, JSON and safetensors each raise kinds of their own
        raise ScoupError(
            f"{with_reason} ({first_line(error)}); check the id, pip install 'scoup[models]', and fetch the "
            "weights (safetensors) while online, or use a table file of text embeddings"
        ) from error
    config, tokenizer, model, loading = loaded
    is_clip = _is_clip(config)
    if not is_clip and not hasattr(model, "get_text_features"):
        raise ScoupError(
            f"{with_reason}: {config.model_type!r} models have no text features; use CLIP or SigLIP"
        )
    missing = sorted(key for key in loading["missing_keys"] if not key.endswith("position_ids"))
    if missing:
        raise ScoupError(
            f"{with_reason}: its file lacks weights such as {missing[0]!r}; use a complete CLIP model"
        )
    model = model.to(device).eval()
    limit = int(getattr(config, "text_config", config).max_position_embeddings)

    def encode(phrases: list[str]) -> Tensor:
        _warn_of_long(phrases, [len(ids) for ids in tokenizer(phrases)["input_ids"]], limit)
        # CLIP looks back only and takes the end's vector, so that what pads the phrases need not be computed.
        padding = "longest" if is_clip else "max_length"
        tokens = tokenizer(phrases, padding=padding, truncation=True, max_length=limit, return_tensors="pt")
        tokens = {name: tensor.to(device) for name, tensor in tokens.items()}
        with torch.inference_mode():
            if is_clip:
                features = model(
                    input_ids=tokens["input_ids"], attention_mask=tokens.get("attention_mask")
                ).text_embeds
            else:  # SigLIP attends to its padding: it was trained without a mask
                features = model.get_text_features(input_ids=tokens["input_ids"])
                features = getattr(features, "pooler_output", features)  # transformers 5 gives an object
        return features.clone()

    return int(encode(["object"]).shape[1]), encode


def _load_transformers(
    transformers: Any, model_id: str, options: dict[str, Any]
) -> tuple[Any, Any, Any, dict[str, Any]]:
    """Config, tokenizer, text model, and what transformers reports of loading it."""
    config = transformers.AutoConfig.from_pretrained(model_id, **options)
    tokenizer = transformers.AutoTokenizer.from_pretrained(model_id, **options)
    kind: Any = transformers.CLIPTextModelWithProjection if _is_clip(config) else transformers.AutoModel
    wanted = config
    if _is_clip(config):
        wanted = getattr(config, "text_config", config)
        # The size of the projection is written twice, and only the outer one is always right.
        wanted.projection_dim = config.projection_dim
    # Safetensors only: loading a pickled checkpoint runs whatever it contains.
    model, loading = kind.from_pretrained(
        model_id, config=wanted, use_safetensors=True, output_loading_info=True, **options
    )
    return config, tokenizer, model, loading


def _is_clip(config: Any) -> bool:
    return config.model_type in ("clip", "clip_text_model")


def _open_open_clip(text: str, device: torch.device | str) -> tuple[int, Encode]:
    architecture, pretrained = open_clip_names(text)
    try:
        import open_clip  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ScoupError(
            f"text model {text!r} needs the package open_clip: pip install 'scoup[open-clip]', "
            "or use a table file of text embeddings"
        ) from error
    try:
        model = open_clip.create_model(architecture, pretrained=pretrained, device=device).eval()
        tokenizer = open_clip.get_tokenizer(architecture)
    except Exception as error:  # as above
        raise ScoupError(
            f"text model {text!r} cannot be loaded ({first_line(error)}); check the id, and fetch the "
            "weights while online, or use a table file of text embeddings"
        ) from error

    def encode(phrases: list[str]) -> Tensor:
        with torch.inference_mode():
            return model.encode_text(tokenizer(phrases).to(device)).clone()

    return int(encode(["object"]).shape[1]), encode


def _warn_of_long(phrases: list[str], lengths: list[int], limit: int) -> None:
    for phrase, length in zip(phrases, lengths, strict=True):
        if length > limit:
            warnings.warn(
                f"the phrase {phrase[:40]!r} has {length} tokens, the text model reads only {limit}: "
                "the rest is ignored",
                ScoupWarning,
                stacklevel=4,
            )
