"""Reasons why a model does not load, in our words: other libraries advise what does not apply here."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

_OF_HUB = {
    "GatedRepoError": "its authors ask for consent; agree on its page of the hub, then run 'hf auth login'",
    "RepositoryNotFoundError": "the hub has no such model, or it is private; check the id",
    "RevisionNotFoundError": "the hub has no such revision of it; check branch, tag or commit",
    "EntryNotFoundError": "the hub's model lacks config.json or weights (.safetensors); use another",
    "HFValidationError": "that is not an id of the hub; expected ORG/NAME, or a folder",
}
_OPEN_CLIP_FILES = ("open_clip_config.json", "open_clip_model.safetensors", "open_clip_pytorch_model.bin")
_SAM_2 = {  # channels of the first layer and number of blocks -> size
    (96, 12): "tiny",
    (96, 16): "small",
    (112, 24): "base-plus",
    (144, 48): "large",
}
_SAM = {768: "base", 1024: "large", 1280: "huge"}  # channels of the image encoder -> size
USE_SAM = "use mobile-sam, or a SAM of transformers by folder or hub id"


def reason_of(source: str, cause: BaseException) -> str:
    """Return problem and remedy for a folder, file or hub id that a library could not load."""
    if isinstance(cause, ImportError):
        named = cause.name or "".join(re.findall(r"requires the (\S+) library", str(cause))[:1])
        return f"it needs a package that is not installed{f' ({named})' if named else ''}"
    if os.path.isdir(source):
        return _reason_of_folder(Path(source))
    if os.path.isfile(source):
        return "the file is damaged or of another kind; fetch it again"
    names = {kind.__name__ for each in _chain(cause) for kind in type(each).__mro__}
    told = [reason for name, reason in _OF_HUB.items() if name in names]
    usual = "its files cannot be fetched or read; check the id, and that its weights are .safetensors"
    return told[0] if told else usual


def _chain(cause: BaseException | None) -> Iterator[BaseException]:
    seen: list[BaseException] = []
    while cause is not None and cause not in seen:
        seen.append(cause)
        yield cause
        cause = cause.__cause__ or cause.__context__


def _reason_of_folder(folder: Path) -> str:
    names = set(os.listdir(folder))
    theirs = [name for name in _OPEN_CLIP_FILES if name in names]
    try:
        config = json.loads((folder / "config.json").read_text("utf-8"))
    except OSError:
        config = None
    except (ValueError, RecursionError):
        return "its config.json is damaged; copy the folder again"
    kind = config.get("model_type") if isinstance(config, dict) else None
    if theirs and kind is None:
        return f"it is a folder of open_clip; pass open_clip:ARCHITECTURE/FILE, where FILE is {folder / theirs[-1]}"
    if config is None:
        return "the folder has no config.json; copy all files of the model"
    if kind is None:
        return "its config.json names no model type; use a model of transformers"
    if not any(name.endswith(".safetensors") for name in names):
        return "the folder has no weights as .safetensors; other kinds may run code and are not read"
    return (
        f"its files are damaged or incomplete, or transformers here does not know {str(kind)[:40]!r} models"
    )


def reason_of_checkpoint(weights: Any, file: str = "") -> str:
    """Return what published weights of other segmenters are, and what to use; "" if they are not known. The name of
    their ``file`` decides between versions and sizes that the weights do not tell."""
    if isinstance(weights, dict) and isinstance(weights.get("model"), dict):
        weights = weights["model"]
    if not isinstance(weights, dict):
        return ""
    names, file = " ".join(map(str, weights)), file.lower().replace("+", "_plus")

    def sizes(name: str) -> tuple[int, ...]:
        found = (rows for key, rows in weights.items() if str(key).endswith(name))
        return tuple(getattr(next(found, None), "shape", ())) or (0,)

    if "spatial_perceiver" in names or "trunk.body." in names or "edgetam" in file:
        return "it is EdgeTAM, whose packages SCOUP does not use; pass facebook/sam2.1-hiera-tiny, which is as small"
    if "image_encoder.trunk." in names:
        blocks = len(set(re.findall(r"trunk\.blocks\.(\d+)\.", names)))
        by_name = next((size for size in _SAM_2.values() if size.replace("-", "_") in file), "tiny")
        size = _SAM_2.get((sizes("trunk.patch_embed.proj.weight")[0], blocks), by_name)
        newer = "no_obj_embed_spatial" in names or (not blocks and not file.startswith("sam2_"))
        same = f"facebook/sam2{'.1' * newer}-hiera-{size}"
        return f"it is SAM 2 as its authors publish it; pass {same}, the same on the hub"
    if "detector.backbone" in names:
        return "it is SAM 3 as its authors publish it; pass facebook/sam3, the same on the hub"
    if "mask_decoder.hf_token" in names:
        return f"it is HQ-SAM, which is not supported; {USE_SAM}"
    by_name = next((size for size in _SAM.values() if f"vit_{size[0]}" in file), "")
    if size := _SAM.get(sizes("image_encoder.pos_embed")[-1], by_name):
        return f"it is SAM as its authors publish it; pass facebook/sam-vit-{size}, the same on the hub"
    return ""
