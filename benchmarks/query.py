"""The cost of a query with a new camera, and of a further one with the same camera."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

import scoup
from benchmarks.processes import SCOUP, run_python
from benchmarks.random_field import everyday_vectors, random_field, write_words
from benchmarks.study import Record, Study
from scoup.models import CANONICAL_PHRASES, EVERYDAY_WORDS
from scoup.query import LanguageField
from scoup.scene import Cameras
from scoup_lab.bench import Stopwatch, markdown, random_scene_cameras, random_scene_gaussians, torch_threads
from scoup_lab.synthetic.random_scene import HEIGHT, WIDTH, clip_like

WORD = "kettle"
STAGES = {
    "project": "project, bin and sort",
    "first relevancy": "relevancy, first query through a view",
    "further relevancy": "relevancy, further query through the same view",
    "query, new camera": "whole answer, new camera",
    "query, same camera": "whole answer, same camera",
    "first location": "location in the scene, first text",
    "further location": "location in the scene, further text",
    "same location": "location in the scene, same text again",
    "ten locations": "location in the scene, ten further texts in one question, some of half of the Gaussians",
    "ten things": "location in the scene, ten further texts in one question, each of about 1 % of the Gaussians",
    "quarter": "whole answer, new camera, at a quarter of the width",
    "scoup query": "`scoup query`: splat and field read, one text, one camera, no pictures",
    "scoup info": "`scoup info`",
}


@dataclass(frozen=True, kw_only=True)
class Query(Study):
    """Time a query to a field of the random scene with made-up codes: times mean something, answers do not.

    Processor seconds, so that other programs on the machine disturb them less; the least of the repetitions counts.
    """

    n_gaussians: int = 1_000_000
    """Of the room."""
    n_atoms: int = 128
    """L."""
    k: int = 4
    """K."""
    width: int = WIDTH
    """Of the view, in pixels."""
    height: int = HEIGHT
    """Of the view, in pixels."""
    threads: int = 1
    """Threads."""
    repeats: int = 7
    """Repetitions of each stage."""
    verb_repeats: int = 3
    """Repetitions of `scoup query` and `scoup info`; 0 omits them."""
    backend: str | None = None
    """Rasteriser; the fastest by default."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        if "stages" in known:
            return
        field = random_field(random_scene_gaussians(self.n_gaussians), self.n_atoms, self.k)
        cameras = random_scene_cameras(4, self.width, self.height)
        camera = cameras[2]
        count = self.repeats + 1  # the first does not count
        queries, canonical = clip_like(count, seed=1), clip_like(len(CANONICAL_PHRASES) + 1, seed=2)
        asked, batch = EVERYDAY_WORDS[: 2 * count], list(EVERYDAY_WORDS[-10:])
        words = scoup.TextEncoder.open(everyday_vectors())
        clock = Stopwatch(time.process_time)
        with torch_threads(self.threads):
            for number in range(count):
                query, other = queries[number][None], queries[number - 1][None]
                view = clock("project", field.at, camera, 1.0, self.backend)
                clock("first relevancy", view.relevancy, other, canonical)
                clock("further relevancy", view.relevancy, query, canonical)
                fresh = field.with_encoder(words)
                clock("first location", fresh.location, asked[2 * number])
                for stage in ("further location", "same location"):
                    clock(stage, fresh.location, asked[2 * number + 1])
                answer = fresh.answer(asked[2 * number + 1])
                unseen = field.at(camera, backend=self.backend)
                for stage in ("drawn, new camera", "drawn, same camera"):
                    clock(stage, unseen.show, [answer])
                clock("ten locations", fresh.location, batch)
                clock("ten things", fresh.location, self._things(fresh, number))
                clock(
                    "quarter",
                    lambda fresh=fresh, text=asked[2 * number + 1]: fresh.at(camera, 0.25).answer(text),
                )
        least = {stage: min(times[1:]) for stage, times in clock.seconds.items()}
        least["query, new camera"] = least["project"] + least.pop("drawn, new camera")
        least["query, same camera"] = least.pop("drawn, same camera")
        yield "stages", least | (self._verbs(field, cameras) if self.verb_repeats else {})

    def record(self, rows: dict[str, Any]) -> Record:
        return {"least": rows["stages"]}

    @staticmethod
    def table(record: Record) -> str:
        least = record["least"]
        return markdown(
            ["", "ms"],
            [[said, f"{1e3 * least[name]:,.0f}"] for name, said in STAGES.items() if name in least],
        )

    @staticmethod
    def _things(field: LanguageField, number: int) -> Tensor:
        """Return ten further vectors [10, D] like embeddings of things: atoms of the middle level."""
        chosen = torch.arange(10 * number, 10 * number + 10) % field.n_atoms
        return torch.nn.functional.normalize(field.codebook[len(field.levels) // 2, chosen], dim=1)

    def _verbs(self, field: LanguageField, cameras: Cameras) -> dict[str, float]:
        """Return the processor seconds of verbs on files; a run before is not counted."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            splat, path = folder / "room.ply", folder / "room.scoup"
            scoup.save_gaussians(field.gaussians, splat)
            words = write_words(folder / "words.npz", WORD)
            stored = scoup.load_gaussians(splat)
            random_field(stored, self.n_atoms, self.k, cameras, words, splat).save(path)
            asked = [WORD, "--camera", cameras[2].name, "--pictures", "none", "--out", str(folder / "out")]
            verbs = {"query": [str(path), *asked, "--overwrite"], "info": [str(path)]}
            return {
                f"scoup {verb}": min(
                    run_python(SCOUP, verb, *arguments, threads=self.threads).cpu_s
                    for _ in range(self.verb_repeats + 1)
                )
                for verb, arguments in verbs.items()
            }
