"""Tiny SAM, SAM 2, SAM 3, CLIP and SigLIP models with random weights, built from configs: no downloads."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import pytest
import torch

# Read when the hub's client is imported: models that do not exist are not searched on the network.
os.environ["HF_HUB_OFFLINE"] = "1"

import transformers


def of_transformers(name: str) -> Any:
    """What has this name there; an older one may lack it, and the test is skipped."""
    if not hasattr(transformers, name):
        pytest.skip(f"transformers {transformers.__version__} has no {name}")
    return getattr(transformers, name)


TINY = {"num_hidden_layers": 1, "num_attention_heads": 2}
TEXT = {**TINY, "hidden_size": 16, "intermediate_size": 8, "vocab_size": 50}
VISION = {**TINY, "hidden_size": 16, "intermediate_size": 16, "patch_size": 8}
SIZES = [[16, 16], [8, 8], [4, 4]]
SAM3_BACKBONE = {
    "model_type": "sam3_vit_model", "hidden_size": 16, "intermediate_size": 16, "num_hidden_layers": 2,
    "num_attention_heads": 2, "image_size": 56, "patch_size": 14, "window_size": 2,
    "global_attn_indexes": [1], "pretrain_image_size": 28,
}  # fmt: skip


def tiny_sam(seed: int = 0) -> Any:
    torch.manual_seed(seed)
    vision = {
        "hidden_size": 16, "output_channels": 16, "num_hidden_layers": 1, "num_attention_heads": 2,
        "image_size": 64, "patch_size": 8, "window_size": 4, "global_attn_indexes": [0], "mlp_dim": 16,
        "num_pos_feats": 8,
    }  # fmt: skip
    prompt = {"hidden_size": 16, "image_size": 64, "patch_size": 8, "mask_input_channels": 4}
    decoder = {"hidden_size": 16, "mlp_dim": 16, "num_hidden_layers": 2, "num_attention_heads": 2,
               "iou_head_hidden_dim": 16}  # fmt: skip
    config = transformers.SamConfig(
        vision_config=vision, prompt_encoder_config=prompt, mask_decoder_config=decoder
    )
    return lively(transformers.SamModel(config).eval())


def tiny_sam2(seed: int = 0) -> Any:
    torch.manual_seed(seed)
    backbone = {
        "model_type": "sam2_hiera_det_model", "hidden_size": 8, "image_size": [64, 64],
        "window_positional_embedding_background_size": [2, 2], "blocks_per_stage": [1, 1, 2, 1],
        "embed_dim_per_stage": [8, 16, 32, 64], "num_attention_heads_per_stage": [1, 1, 2, 2],
        "window_size_per_stage": [8, 4, 4, 4], "global_attention_blocks": [3],
    }  # fmt: skip
    vision = {
        "backbone_config": backbone, "backbone_channel_list": [64, 32, 16, 8], "fpn_hidden_size": 32,
        "backbone_feature_sizes": SIZES,
    }  # fmt: skip
    config = of_transformers("Sam2Config")(
        vision_config=vision,
        prompt_encoder_config={"hidden_size": 32, "image_size": 64, "mask_input_channels": 4},
        mask_decoder_config={**TINY, "hidden_size": 32, "mlp_dim": 16, "iou_head_hidden_dim": 16},
    )
    return lively(transformers.Sam2Model(config).eval())


def tiny_sam3(seed: int = 0) -> Any:
    torch.manual_seed(seed)
    vision = {
        "model_type": "sam3_vision_model", "backbone_config": SAM3_BACKBONE, "fpn_hidden_size": 32,
        "backbone_feature_sizes": SIZES,
    }  # fmt: skip
    config = of_transformers("Sam3TrackerConfig")(
        vision_config=vision,
        prompt_encoder_config={"hidden_size": 32, "image_size": 56, "mask_input_channels": 4},
        mask_decoder_config={**TINY, "hidden_size": 32, "mlp_dim": 16, "iou_head_hidden_dim": 16},
    )
    return lively(transformers.Sam3TrackerModel(config).eval())


def tiny_sam2_video(seed: int = 0) -> Any:
    """As SAM 2.1 is published: a video model, whose file holds the image model too."""
    image = tiny_sam2(seed).config
    config = of_transformers("Sam2VideoConfig")(
        vision_config=image.vision_config.to_dict(),
        prompt_encoder_config=image.prompt_encoder_config.to_dict(),
        mask_decoder_config=image.mask_decoder_config.to_dict(),
        image_size=64, memory_attention_hidden_size=32, memory_attention_feed_forward_hidden_size=16,
        memory_attention_num_layers=1, memory_encoder_hidden_size=32, memory_encoder_output_channels=16,
        mask_downsampler_embed_dim=32, memory_fuser_embed_dim=32, memory_fuser_intermediate_dim=16,
        memory_fuser_num_layers=1,
    )  # fmt: skip
    return lively(transformers.Sam2VideoModel(config).eval())


def lively(model: Any) -> Any:
    """Random weights large enough that masks depend on image and point, in the range of the filters."""
    with torch.no_grad():
        for name, parameter in model.named_parameters():
            if parameter.dim() > 1:
                parameter.normal_(0, 1.0 / parameter[0].numel() ** 0.5)
            if "iou_prediction_head" in name and name.endswith("bias"):
                parameter.fill_(0.4)
    return model


TINY_SAMS = {"sam": tiny_sam, "sam2": tiny_sam2, "sam3": tiny_sam3}


def tiny_clip(seed: int = 0, side: int = 32) -> Any:
    torch.manual_seed(seed)
    config = transformers.CLIPConfig(
        text_config={**TEXT, "hidden_size": 8, "projection_dim": 12},
        vision_config={**VISION, "image_size": side, "projection_dim": 12},
        projection_dim=12,
    )
    return lively(transformers.CLIPModel(config).eval())


def tiny_siglip(seed: int = 0, side: int = 32) -> Any:
    torch.manual_seed(seed)
    config = transformers.SiglipConfig(text_config=TEXT, vision_config={**VISION, "image_size": side})
    return lively(transformers.SiglipModel(config).eval())


def tiny_siglip2(seed: int = 0) -> Any:
    """The variant for images of any shape, NaFlex."""
    torch.manual_seed(seed)
    config = of_transformers("Siglip2Config")(text_config=TEXT, vision_config={**VISION, "num_patches": 16})
    return lively(of_transformers("Siglip2Model")(config).eval())


def tiny_tips(seed: int = 0, **text: Any) -> Any:
    torch.manual_seed(seed)
    config = of_transformers("Tipsv2Config")(
        text_config={**TEXT, **text},
        vision_config={"hidden_size": 16, "num_hidden_layers": 2, "num_attention_heads": 2, "image_size": 32,
                       "patch_size": 8, "layerscale_value": 0.7, "num_register_tokens": 2},
    )  # fmt: skip
    return lively(of_transformers("Tipsv2Model")(config).eval())


def saved(model: Any, folder: Path, **preprocessor: Any) -> Path:
    """The model as a folder that ``from_pretrained`` reads, with a preprocessor_config.json if given any."""
    model.save_pretrained(folder)
    if preprocessor:
        (folder / "preprocessor_config.json").write_text(json.dumps(preprocessor))
    return folder


def word_tokenizer(names: list[str]) -> Any:
    """One that numbers words by their places; the first stands for all others."""
    from tokenizers import Tokenizer
    from tokenizers.models import WordLevel
    from tokenizers.pre_tokenizers import Whitespace

    tokenizer = Tokenizer(WordLevel({name: place for place, name in enumerate(names)}, unk_token=names[0]))
    tokenizer.pre_tokenizer = Whitespace()  # pyright: ignore
    return tokenizer


def tiny_tokenizer(folder: Path, words: list[str]) -> None:
    """Saves one that knows a few words."""
    from tokenizers.processors import TemplateProcessing

    tokenizer = word_tokenizer(["<unk>", "<bos>", *words, "<eos>"])
    tokenizer.post_processor = TemplateProcessing(
        single="<bos> $A <eos>", special_tokens=[("<bos>", 1), ("<eos>", len(words) + 2)]
    )
    transformers.PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, bos_token="<bos>", eos_token="<eos>", pad_token="<eos>", unk_token="<unk>"
    ).save_pretrained(folder)


WORDS = ["object", "red", "apple", "chair"]
TINY_TEXT = {
    "hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2,
    "vocab_size": 7, "max_position_embeddings": 8, "bos_token_id": 1, "eos_token_id": 6, "pad_token_id": 6,
}  # fmt: skip


def save_text_clip(folder: Path, seed: int = 0) -> Path:
    """A CLIP model with a tokenizer of ``WORDS``."""
    torch.manual_seed(seed)
    vision = {**VISION, "intermediate_size": 32, "image_size": 8, "patch_size": 4}
    config = transformers.CLIPConfig(text_config=TINY_TEXT, vision_config=vision, projection_dim=12)
    tiny_tokenizer(saved(transformers.CLIPModel(config), folder), WORDS)
    return folder


TINY_WORDS = ["red", "apple", "chair", "lamp"]


def save_owl(folder: Path, seed: int = 0) -> Any:
    """An OWLv2 with a tokenizer of ``TINY_WORDS``."""
    torch.manual_seed(seed)
    config = of_transformers("Owlv2Config")(
        text_config={**TINY_TEXT, "intermediate_size": 16, "num_hidden_layers": 1, "max_position_embeddings": 16,
                     "pad_token_id": 0},
        vision_config={**VISION, "image_size": 48, "patch_size": 16},
        projection_dim=16,
    )  # fmt: skip
    model = lively(transformers.Owlv2ForObjectDetection(config).eval())
    tiny_tokenizer(saved(model, folder), TINY_WORDS)
    return model


def save_grounding_dino(folder: Path, seed: int = 0) -> Any:
    """A Grounding DINO whose tokenizer has the numbers of BERT's special tokens, by which the model finds texts."""
    torch.manual_seed(seed)
    config = of_transformers("GroundingDinoConfig")(
        backbone_config={"model_type": "swin", "embed_dim": 8, "depths": [1, 1, 1, 1], "num_heads": [1, 1, 2, 2],
                         "window_size": 2, "image_size": 32, "out_features": ["stage2", "stage3", "stage4"]},
        text_config={**TINY, "model_type": "bert", "vocab_size": 1013, "hidden_size": 16, "intermediate_size": 16},
        d_model=32, encoder_layers=1, decoder_layers=2, encoder_attention_heads=2, decoder_attention_heads=2,
        encoder_ffn_dim=16, decoder_ffn_dim=16, num_queries=9, max_text_len=12, disable_custom_kernels=True,
    )  # fmt: skip
    model = lively(transformers.GroundingDinoForObjectDetection(config).eval())
    model.save_pretrained(folder)
    names = ["[PAD]", *TINY_WORDS, *(f"##{number}" for number in range(5, 1013))]
    names[101], names[102], names[1012] = "[CLS]", "[SEP]", "."
    special = {"cls_token": "[CLS]", "sep_token": "[SEP]", "pad_token": "[PAD]", "unk_token": "[PAD]"}
    transformers.PreTrainedTokenizerFast(tokenizer_object=word_tokenizer(names), **special).save_pretrained(
        folder
    )
    return model


def save_sam3_concepts(folder: Path, seed: int = 0) -> Any:
    """A SAM 3 that takes texts, with a tokenizer of ``TINY_WORDS``."""
    torch.manual_seed(seed)
    detr = {"hidden_size": 32, "num_layers": 1, "num_attention_heads": 2, "intermediate_size": 16}
    config = of_transformers("Sam3Config")(
        vision_config={"backbone_config": SAM3_BACKBONE, "fpn_hidden_size": 32, "backbone_feature_sizes": SIZES},
        text_config={**TINY_TEXT, "model_type": "clip_text_model", "intermediate_size": 16, "projection_dim": 16,
                     "num_hidden_layers": 1, "max_position_embeddings": 32},
        geometry_encoder_config=detr, detr_encoder_config=detr, detr_decoder_config={**detr, "num_queries": 6},
        mask_decoder_config={"hidden_size": 32, "num_attention_heads": 2},
    )  # fmt: skip
    model = lively(transformers.Sam3Model(config).eval())
    tiny_tokenizer(saved(model, folder), TINY_WORDS)
    return model
