"""The time of embeddings of a photograph's regions: one pass over the photograph, or one per region."""

from __future__ import annotations

import os
import resource
import tempfile
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from PIL import Image

import scoup
from benchmarks.data import data_folder
from benchmarks.study import Record, Study
from scoup.base.errors import InputError
from scoup.extract import Masks, open_embedder
from scoup.extract.crops import mask_crops
from scoup.extract.interfaces import RegionEmbedder
from scoup_lab.bench import markdown

SIZE = (988, 731)  # of a photograph of LERF
VIEW = "input_0001"
MODELS = {"clip": "CLIP ViT-B/16", "siglip": "SigLIP ViT-B/16"}


@dataclass(frozen=True, kw_only=True)
class Embedding(Study):
    """Measure seconds per photograph of embeddings on a CPU, with random weights of the real size.

    The photograph and its regions at three levels are those of the real scene desk, enlarged to the size of LERF's.
    Each way runs in a process of its own, whose peak memory includes model and libraries.
    """

    threads: int = 2
    """Of PyTorch."""
    repeats: int = 3
    """Photographs, after one that is not timed; the fastest counts. Crops are timed once."""

    def check(self) -> None:
        if not (data_folder() / "desk").is_dir():
            raise InputError(f"{data_folder() / 'desk'}: there is no such scene; set SCOUP_TEST_DATA")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        os.environ["HF_HUB_OFFLINE"] = "1"
        with tempfile.TemporaryDirectory() as folder:
            for model in MODELS:
                ways = [way for way in ("dense", "crops") if f"{model}/{way}" not in known]
                if ways:
                    save_model(model, Path(folder) / model)
                for way in ways:
                    repeats = self.repeats if way == "dense" else 1
                    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                        task = (str(Path(folder) / model), way, self.threads, repeats)
                        yield f"{model}/{way}", pool.submit(_embed, *task).result()

    def line(self, figures: Any) -> str:
        return f"{figures['seconds']:.2f} s, {figures['cpu_seconds']:.2f} CPU s"

    @staticmethod
    def table(record: Record) -> str:
        """Return one row per model and way."""
        body = []
        for key, of in record["rows"].items():
            model, way = key.split("/")
            passes = f"{of['regions']} crops" if way == "crops" else "the photograph, `dense:MODEL`"
            seconds = [f"{of['seconds']:.2f}", f"{of['cpu_seconds']:.2f}", f"{of['peak_gb']:.1f}"]
            body.append([f"{MODELS[model]}, {passes}", *seconds])
        threads = record["settings"]["threads"]
        return markdown(["embeddings of", f"seconds, {threads} threads", "CPU seconds", "peak GB"], body)


def save_model(kind: str, folder: Path, text_layers: int = 1) -> None:
    """Write a model with an image tower of ViT-B/16 size (224 pixels) and random weights."""
    import transformers

    torch.manual_seed(0)
    image = {
        "hidden_size": 768, "intermediate_size": 3072, "num_hidden_layers": 12, "num_attention_heads": 12,
        "image_size": 224, "patch_size": 16,
    }  # fmt: skip
    text = {"num_hidden_layers": text_layers}
    if kind == "clip":
        config = transformers.CLIPConfig(text_config=text, vision_config=image, projection_dim=512)
        transformers.CLIPModel(config).save_pretrained(folder)
    else:
        config = transformers.SiglipConfig(text_config=text, vision_config=image)
        transformers.SiglipModel(config).save_pretrained(folder)


def _embed(folder: str, way: str, threads: int, repeats: int) -> Record:
    """Return the time of the embeddings of all regions of the photograph, and the peak memory of the process."""
    torch.set_num_threads(threads)
    image, masks = _photograph()
    embedder = open_embedder(f"dense:{folder}" if way == "dense" else folder)

    def embed() -> None:
        if isinstance(embedder, RegionEmbedder):
            embedder.embed_regions(image, masks)
        else:
            for found in masks.values():
                for crops in mask_crops(image, found, embedder.side):
                    embedder.embed(crops)

    if way == "dense":
        embed()
    times = []
    for _ in range(repeats):
        wall, cpu = time.perf_counter(), time.process_time()
        embed()
        times.append((time.perf_counter() - wall, time.process_time() - cpu))
    return {
        "regions": sum(map(len, masks.values())),
        "seconds": min(wall for wall, _ in times),
        "cpu_seconds": min(cpu for _, cpu in times),
        "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e9,
    }


def _photograph() -> tuple[torch.Tensor, dict[str, Masks]]:
    desk = data_folder() / "desk"
    camera = scoup.load_cameras(desk)[VIEW]
    regions = scoup.load_regions(desk / "language_features", scoup.load_cameras(desk))
    with Image.open(desk / "images_2" / camera.name) as file:
        image = torch.from_numpy(np.array(file.convert("RGB").resize(SIZE)))
    labels = regions.load_labels(camera.name, *SIZE)
    return image, {
        level: Masks.from_labels(of.numpy()) for level, of in zip(regions.levels, labels, strict=True)
    }
