"""Questions about scenes of real models, answered from what the tools of agents reply, and from nothing else."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch

import scoup
from benchmarks.data import data_folder
from benchmarks.real_scenes import FOLDERS, RealScene
from benchmarks.study import Record, Study
from scoup.view.mcp_server import make_server
from scoup.view.scene_tools import SceneTools
from scoup_lab.bench import markdown

Call = Callable[..., Any]
QUESTIONS: dict[str, list[tuple[str, str, Any]]] = {
    "table-real": [
        ("what is on", "table", "chair,picture frame,globe,potted plant,table,carpet,window,cushion"),
        ("where is", "teapot", None),
        ("how many", "teapot", 1),
        ("how many", "book", 3),
        ("which is left of the laptop computer", "alarm clock or bottle", "view_00.png"),
        ("which is on the other", "doughnut or plate", None),
        ("is there", "elephant", None),
    ],
    "desk": [
        ("what is on", "desk", "desk,box,lamp,shirt,handle,scarf"),
        ("where is", "kettle", None),
        ("where is", "penguin", None),
        ("how many", "mouse", 1),
        ("which is right of the laptop computer", "penguin or kettle", "input_0002.jpg"),
        ("which is on the other", "mouse or mousepad", None),
        ("is there", "elephant", None),
    ],
}
"""By scene: the kind, what is asked, and names of the scene that are not on it, how many there are, or the camera that
is meant. Of "which", the first is right. They were written before any answer was seen."""


@dataclass(frozen=True, kw_only=True)
class Agents(Study):
    """Ask two scenes of real models 12 questions of what, where, how many and which, and for an elephant, by the tools
    of `scoup mcp`, called by the protocol's own client; fixed rules make answers of the replies.

    What is on the table: three names of the graph, largest things first, all truly on it. Where: the position lies in
    the mask of the name in most labelled views. Which: of two phrases only the true one finds something. Names of
    things are of one list for both scenes: the names that all scenes of real models are asked for.
    """

    data: Path = field(default_factory=data_folder)
    """Folder that contains desk/ and real/."""

    def measure(self, known: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
        for name in QUESTIONS:
            if name not in known:
                yield name, asyncio.run(_asked(name, self.data))

    def record(self, rows: dict[str, Any]) -> Record:
        every = [row for of_scene in rows.values() for row in of_scene]
        asked = [row["right"] for row in every if not row["question"].startswith("is there")]
        return {"right": sum(asked), "questions": len(asked), "rows": rows}

    @staticmethod
    def table(record: Record) -> str:
        """Return a row per question."""
        body = [
            [scene, row["question"], row["answer"], "yes" if row["right"] else "no"]
            for scene, rows in record["rows"].items()
            for row in rows
        ]
        return markdown(["scene", "question", "answer", "right"], body, left=4)


async def _asked(name: str, data: Path) -> list[Record]:
    from mcp import Client

    scene = RealScene.open(name, data)
    gaussians = scoup.load_gaussians(data / FOLDERS[name] / "point_cloud.splat")
    built = scoup.build(gaussians, scene.cameras, scene.regions)
    built.text_encoder(data / "desk" / "desk_words.npz")
    known = {word for folder in FOLDERS.values() for word in _names(data / folder)}
    words = tuple(sorted(known.intersection(built.text_encoder().names or ())))
    rows = []
    async with Client(make_server(SceneTools({"scene": built}, words=words))) as client:

        async def call(tool: str, **arguments: Any) -> Any:
            reply: Any = await client.call_tool(tool, {"scene": "scene", **arguments})
            return json.loads(reply.content[0].text)

        for kind, asked, truth in QUESTIONS[name]:
            answer, right = await _answer(call, scene, kind, asked, truth)
            rows.append({"question": f"{kind} {asked}?", "answer": answer, "right": right})
    return rows


async def _answer(call: Call, scene: RealScene, kind: str, asked: str, truth: Any) -> tuple[str, bool]:
    """Return the answer to a question, and whether it is right."""
    if kind.startswith("which is "):
        (one, other), relation = asked.split(" or "), kind.removeprefix("which is ")
        phrases = [
            f"{name} {relation.replace('the other', rest)}" for name, rest in ((one, other), (other, one))
        ]
        counts = [(await call("find", text=text, seen_from=truth))["count"] for text in phrases]
        found = [name for name, count in zip((one, other), counts, strict=True) if count]
        return " and ".join(found) or "neither", found == [one]
    reply = await call("find", text=f"how many {asked}" if kind == "how many" else asked)
    if kind == "how many":
        return str(reply["count"]), reply["count"] == truth
    if not reply["count"]:
        certainty = reply["texts"][0]["certainty"]
        return certainty, kind == "is there" and certainty == "not here"
    first = reply["things"][0]
    if kind != "what is on":
        place = "{:.2f}, {:.2f}, {:.2f}".format(*first["position"])
        return place, kind == "where is" and _is_in(scene, asked, first["position"])
    graph = (await call("describe_scene", thing=first["thing"]))["things"]
    names = [each["text"] for each in graph if each["text"] and first["thing"] in each.get("on", ())]
    three = list(dict.fromkeys(names))[:3]
    on_it = _names(scene.folder, truth.split(","))
    return ", ".join(three) or "nothing", len(three) == 3 and on_it.issuperset(three)


def _names(folder: Path, left_out: Sequence[str] = ()) -> set[str]:
    """Return the names of what is in a scene, with other names of the same, but for some."""
    meanings = json.loads((folder / "words.json").read_text())
    if "asked" in meanings:  # desk
        meanings = {name: meanings["other_names_of_asked"].get(name, []) for name in meanings["asked"]}
    return {each for name, others in meanings.items() if name not in left_out for each in (name, *others)}


def _is_in(scene: RealScene, label: str, position: list[float]) -> bool:
    """Return whether a position lies in the mask of a label in most of the labelled views that have it."""
    hits = []
    for frame, camera in scene.frames:
        if label in frame.masks:
            seen = camera.viewmat[:3, :3].double() @ torch.tensor(position).double() + camera.viewmat[:3, 3]
            column, row = ((camera.K.double() @ seen)[:2] / seen[2]).floor().int().tolist()
            mask = frame.masks[label]
            inside = 0 <= row < mask.shape[0] and 0 <= column < mask.shape[1] and float(seen[2]) > 0
            hits.append(inside and bool(mask[row, column]))
    return sum(hits) > len(hits) / 2
