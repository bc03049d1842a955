"""MobileSAM's checkpoint as a SAM of transformers whose vision encoder is ``TinyViT``."""

from __future__ import annotations

import pickle
import re
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from scoup.base import ScoupError
from scoup.models.failures import USE_SAM, reason_of_checkpoint
from scoup.models.tiny_vit import TinyViT

MOBILE_SAM_FILE = ("dhkim2810/MobileSAM", "mobile_sam.pt")  # repository of the hub, and the file in it
CHECKPOINT_URL = "https://github.com/ChaoningZhang/MobileSAM/raw/master/weights/mobile_sam.pt"

_DAMAGED = "the file is damaged or not a checkpoint; fetch it again"
_RENAMES = (  # a name in the checkpoint (a pattern) -> its name in transformers
    (r"image_encoder\.(norm_head|head)\..*", ""),  # of the classifier that TinyViT was
    (r"image_encoder\.", "vision_encoder."),
    (r"prompt_encoder\.pe_layer\.positional_encoding_gaussian_matrix", "shared_image_embedding.positional_embedding"),
    (r"prompt_encoder\.point_embeddings\.", "prompt_encoder.point_embed."),
    (r"mask_downscaling\.0\.", "mask_embed.conv1."),
    (r"mask_downscaling\.1\.", "mask_embed.layer_norm1."),
    (r"mask_downscaling\.3\.", "mask_embed.conv2."),
    (r"mask_downscaling\.4\.", "mask_embed.layer_norm2."),
    (r"mask_downscaling\.6\.", "mask_embed.conv3."),
    (r"output_upscaling\.0\.", "upscale_conv1."),
    (r"output_upscaling\.1\.", "upscale_layer_norm."),
    (r"output_upscaling\.3\.", "upscale_conv2."),
    (r"(mask_decoder\.transformer\..*)norm(\d|_final_attn)\.", r"\1layer_norm\2."),
    (r"(output_hypernetworks_mlps\.\d|iou_prediction_head)\.layers\.2\.", r"\1.proj_out."),
    (r"(output_hypernetworks_mlps\.\d|iou_prediction_head)\.layers\.0\.", r"\1.proj_in."),
    (r"(output_hypernetworks_mlps\.\d|iou_prediction_head)\.layers\.1\.", r"\1.layers.0."),
)  # fmt: skip


def sam_of_checkpoint(transformers: Any, path: Path) -> Any:
    """Read ``mobile_sam.pt`` as its authors publish it: a ``SamModel`` in evaluation mode, on the CPU, in 32 bits.

    Only tensors are read, no code. Other weights and files raise ScoupError.
    """
    try:
        weights = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        if "GLOBAL" not in str(error):  # torch's word for what is not a tensor
            raise ScoupError(_DAMAGED) from error
        problem = "it contains objects of other code, as FastSAM and YOLO do, which is not supported"
        raise ScoupError(f"{problem}; {USE_SAM}") from error
    except (EOFError, LookupError, OSError, RuntimeError, TypeError, ValueError, AttributeError) as error:
        raise ScoupError(_DAMAGED) from error
    return _fill(_empty_model(transformers), weights, path.name)


def _empty_model(transformers: Any) -> Any:
    # Layers of the decoder add 1e-5 under the root, as in SAM's own code; transformers' default is 1e-6.
    config = transformers.SamConfig(
        vision_config={"num_hidden_layers": 0}, mask_decoder_config={"layer_norm_eps": 1e-5}
    )
    model = transformers.SamModel(config)
    model.vision_encoder = TinyViT()
    return model.eval()


def _fill(model: Any, weights: Any, file: str) -> Any:
    if reason := reason_of_checkpoint(weights, file):
        raise ScoupError(reason)
    if not isinstance(weights, dict):
        raise ScoupError(f"it contains no weights by name; {USE_SAM}")
    given = {_rename(str(name)): value for name, value in weights.items()}
    given.pop("", None)
    places = "shared_image_embedding.positional_embedding"
    if places in given:
        given["prompt_encoder.shared_embedding.positional_embedding"] = given[places]
    expected: dict[str, Tensor] = model.state_dict()
    for name in sorted({*expected, *given}):
        if name not in given or name not in expected or given[name].shape != expected[name].shape:
            raise ScoupError(
                f"it is not MobileSAM's checkpoint: weight {name!r} is missing, unknown or of another shape; {USE_SAM}"
            )
    model.load_state_dict(given)
    model.vision_encoder.fold()
    return model


def _rename(name: str) -> str:
    for pattern, new in _RENAMES:
        name = re.sub(pattern, new, name)
    return name
