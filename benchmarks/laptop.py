"""From photographs to the first answer, by the commands of a user, on this machine."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from benchmarks.processes import SCOUP, run_python
from benchmarks.scenes import scene_of
from benchmarks.study import Record, Study, report
from scoup.base import InputError
from scoup_lab.bench import markdown
from scoup_lab.synthetic.folder import write_demo_scene

ASKED = ("first answer", "further answer")
EMBEDDERS = {"a crop per region": "", "one forward pass per photograph": "dense:"}
"""Ways to embed regions, the default first -> how `--embedder` begins."""


@dataclass(frozen=True, kw_only=True)
class Laptop(Study):
    """Time `scoup build` from photographs, and `scoup query`, in processes of their own.

    Photographs are renders of a procedural scene. MobileSAM is real; the CLIP ViT-B/16 has random weights and a
    tokenizer of few words, so its times mean something, the answers do not.
    """

    weights: Path
    """MobileSAM's checkpoint."""
    scene: str = "hall-30"
    """Layout and seed."""
    photographs: int = 200
    """Of the scene."""
    width: int = 953
    """Of a photograph, in pixels."""
    height: int = 535
    """Of a photograph, in pixels."""
    n_gaussians: int = 300_000
    """Of the splat."""

    def check(self) -> None:
        if not self.weights.is_file():
            raise InputError(f"{self.weights}: there is no such file; name MobileSAM's checkpoint")

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        missing = [way for way in EMBEDDERS if f"{way}: {ASKED[-1]}" not in known]
        if not missing:
            return
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            scene, model, field = folder / "scene", folder / "clip", folder / "field.scoup"
            made = scene_of(self.scene, self.n_gaussians, self.width, self.height, self.photographs, 1)
            write_demo_scene(made, scene, progress=report)
            _save_clip(model)
            _save_tokenizer(model, made.words.texts)
            for way in missing:
                os.environ["SCOUP_CACHE"] = str(folder / way / "cache")  # no everyday words of an earlier run
                shutil.rmtree(scene / "language_features")
                models = ["--segmenter", str(self.weights), "--embedder", f"{EMBEDDERS[way]}{model}"]
                yield (
                    f"{way}: build",
                    _timed("build", str(scene), *models, "--out", str(field), "--overwrite"),
                )
                for row, text in zip(ASKED, made.layout.favourites, strict=False):
                    out = str(folder / way / row)
                    yield (
                        f"{way}: {row}",
                        _timed("query", str(field), text, "--pictures", "none", "--out", out),
                    )

    def line(self, figures: Any) -> str:
        return f"{figures['wall_s']:.0f} s, {figures['peak_gb']:.1f} GB"

    @staticmethod
    def steps(record: Record, way: str) -> dict[str, float]:
        """Return the seconds of each step to the first answer with one way to embed."""
        build, first = (record["rows"][f"{way}: {row}"] for row in ("build", ASKED[0]))
        stages, seconds = build["said"]["extraction"]["stages"], build["said"]["seconds"]
        return {
            "masks": stages["segment"],
            "embeddings": stages["embed"],
            "choosing, files, start": build["wall_s"] - stages["segment"] - stages["embed"] - seconds,
            "the field": seconds,
            "first answer": first["wall_s"],
        }

    @staticmethod
    def table(record: Record) -> str:
        """Return the seconds of each step, and their sum, a row per way to embed."""
        body, names = [], list[str]()
        for way in EMBEDDERS:
            steps = Laptop.steps(record, way)
            extraction = record["rows"][f"{way}: build"]["said"]["extraction"]
            each = (steps["masks"] + steps["embeddings"]) / extraction["made"]
            total = sum(steps.values())
            figures = {
                **steps,
                "all": total,
                f"all, of all {record['settings']['photographs']} photographs (computed)": total
                + each * (record["settings"]["photographs"] - extraction["made"]),
            }
            names = list(figures)
            further = record["rows"][f"{way}: {ASKED[1]}"]["wall_s"]
            body.append([way, *(f"{seconds:.0f}" for seconds in figures.values()), f"{further:.1f}"])
        return markdown(["embeddings by", *names, "a further answer"], body)


def _timed(verb: str, *arguments: str) -> Record:
    """Return what a verb said, its wall time, the time of its processor and its peak memory."""
    done = run_python(SCOUP, verb, *arguments, "--json")
    said = {
        key: value
        for key, value in json.loads(done.said).items()
        if key in ("extraction", "seconds", "views")
    }
    return {"said": said, "wall_s": done.wall_s, "cpu_s": done.cpu_s, "peak_gb": done.peak_bytes / 1e9}


def _save_clip(folder: Path) -> None:
    """Write a CLIP of the size of ViT-B/16 with random weights."""
    import transformers

    torch.manual_seed(0)
    image = {
        "hidden_size": 768, "intermediate_size": 3072, "num_hidden_layers": 12, "num_attention_heads": 12,
        "image_size": 224, "patch_size": 16,
    }  # fmt: skip
    config = transformers.CLIPConfig(
        text_config={"num_hidden_layers": 12}, vision_config=image, projection_dim=512
    )
    transformers.CLIPModel(config).save_pretrained(folder)


def _save_tokenizer(folder: Path, words: tuple[str, ...] | list[str]) -> None:
    """Write a tokenizer of few words beside a CLIP; others are unknown to it."""
    import transformers
    from tokenizers import Tokenizer
    from tokenizers.models import WordLevel
    from tokenizers.pre_tokenizers import Whitespace
    from tokenizers.processors import TemplateProcessing

    start, end = ("<start>", 49406), ("<end>", 49407)  # as CLIP's
    known = {
        word: number for number, word in enumerate(sorted({part for text in words for part in text.split()}))
    }
    tokenizer = Tokenizer(WordLevel({**known, "<unknown>": len(known), **dict((start, end))}, "<unknown>"))
    tokenizer.pre_tokenizer = Whitespace()  # pyright: ignore
    tokenizer.post_processor = TemplateProcessing(single="<start> $A <end>", special_tokens=[start, end])  # pyright: ignore
    transformers.PreTrainedTokenizerFast(
        tokenizer_object=tokenizer,
        bos_token="<start>",
        eos_token="<end>",
        pad_token="<end>",
        unk_token="<unknown>",
    ).save_pretrained(folder)
