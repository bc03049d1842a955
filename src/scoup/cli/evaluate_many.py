"""scoup eval baselines, presence: many ways on the scenes of one data set, and what such commands share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from scoup.cli.build import CLIP_MODEL
from scoup.cli.console import Console
from scoup.cli.evaluate_data_sets import DataSetOptions, Names
from scoup.cli.options import Flag, common_last

if TYPE_CHECKING:
    from scoup.evaluate.studies.rasterised import PreparedScene
    from scoup.evaluate.tables import Table
    from scoup.pictures.colors import Picture
    from scoup.query.presets import QueryPreset


@dataclass(frozen=True, kw_only=True)
class ManyOptions(DataSetOptions):
    """Options of commands that try many ways on a data set."""

    data_set: Literal["lerf-ovs", "3d-ovs", "mipnerf360"] = "lerf-ovs"
    """Layout of ROOT, and whose protocol scores."""
    rules: Literal["scoup", "langsplatv2", "langsplat"] = "scoup"
    """Whose constants turn relevancy into masks and points."""

    def folder(self) -> Path:
        """For outputs."""
        return self.out or Path(f"eval_{self.data_set}")

    def preset(self) -> QueryPreset:
        """The rules of the protocol."""
        from scoup.evaluate.datasets import data_set_preset, find_data_set

        return data_set_preset(find_data_set(self.data_set), self.rules)

    def prepared(self, console: Console) -> list[PreparedScene]:
        """The scenes with their splats, regions and words."""
        from scoup.evaluate.datasets import find_data_set, find_scenes, open_scene
        from scoup.evaluate.scoring import encode_labels, text_source
        from scoup.evaluate.studies.rasterised import prepare_scene

        data_set = find_data_set(self.data_set)
        names = find_scenes(data_set, self.root, self.scenes)
        scenes = []
        for name in names:
            scene = open_scene(data_set, self.root, name, self.places(), self.undistort)
            asked = encode_labels(scene, text_source(self.root, scene, self.text, CLIP_MODEL))
            scenes.append(prepare_scene(data_set, scene, asked))
            console.say(
                f"{name}: {len(scenes[-1].gaussians):,} Gaussians, {scene.n_pairs} (frame, label) pairs"
            )
        return scenes

    def check(self, stem: str) -> None:
        """Refuse outputs that are there, before any work."""
        from scoup.io import check_output

        for suffix in (".md", ".json", ".tex"):
            check_output(self.folder() / f"{stem}{suffix}", self.overwrite)

    def write(
        self,
        console: Console,
        stem: str,
        tables: Sequence[Table],
        title: str,
        record: dict[str, Any],
        pictures: dict[str, Picture] | None = None,
    ) -> None:
        """Write and show tables; ``pictures`` by file name."""
        from scoup.evaluate.writing import write_tables
        from scoup.io import save_png

        out, pictures = self.folder(), pictures or {}
        for name, picture in pictures.items():
            save_png(picture, out / name, overwrite=True)
        write_tables(tables, out, stem, title, record, self.overwrite, list(pictures))
        for table in tables:
            console.say("\n" + table.markdown())
        console.say(f"{out / stem}.md, .json, .tex" + "".join(f", {name}" for name in pictures))
        console.result({"out": out, **record})


@common_last
@dataclass(frozen=True, kw_only=True)
class Baselines(ManyOptions):
    """Compare the method with dense uplift, centre pixels (Occam's LGS), visible centre pixels (VALA), top contributors
    with product quantisation (Dr. Splat) and LangSplat's autoencoder, on the same regions and with the same queries.

    Accuracy, time, memory and storage of each; docs/evaluation.md says what each follows and where it departs.
    """

    methods: Annotated[Names, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = ()
    """Methods to run; repeat it for several. Default: all."""
    seed: int = 0
    """Of all that is random."""
    epochs: int = 100
    """Of the autoencoder; LangSplat's own is 100."""
    selection: Flag = False
    """Also score by the 3D-selection protocol, in a table of its own."""

    def run(self, console: Console) -> None:
        """Run all and write the tables."""
        from dataclasses import replace

        from scoup.baselines.autoencoder import LANGSPLAT
        from scoup.baselines.methods import METHODS, MethodSettings, find_method
        from scoup.bench.environment import describe_environment
        from scoup.evaluate.studies.comparison import (
            compare,
            comparison_record,
            comparison_table,
            difference_table,
            selection_table,
        )

        chosen = [find_method(name) for name in self.methods or METHODS]
        self.check("baselines")
        scenes = self.prepared(console)
        settings = MethodSettings(self.seed, autoencoder=replace(LANGSPLAT, epochs=self.epochs))
        with console.progress() as progress:
            results = compare(scenes, chosen, self.preset(), settings, self.selection, progress)
        protocol = results[0].score.protocol
        title = f"{protocol}, {len(scenes)} scenes: methods compared"
        tables = [comparison_table(results, title)]
        if len(chosen) > 1:
            tables.append(
                difference_table(results, chosen[0].name, f"{protocol}: {chosen[0].name} against the others")
            )
        selected = selection_table(results, f"3D selection, {len(scenes)} scenes: methods compared")
        tables += [selected] if selected is not None else []
        record = {
            "protocol": protocol,
            "rules": self.rules,
            "seed": self.seed,
            "epochs": self.epochs,
            "environment": describe_environment(),
            "methods": comparison_record(results),
            "follows": {method.name: [method.system, method.follows, method.departs] for method in chosen},
        }
        self.write(console, "baselines", tables, "Methods compared", record)


@common_last
@dataclass(frozen=True, kw_only=True)
class Presence(ManyOptions):
    """How well it can be told that something is not there: precision and recall of presence in views and scenes, by how
    far a query stands above everyday words, and by other signals.

    Absent words are the lines of absent.txt in each scene's folder, or else the labels of the other scenes. Bounds are
    judged on scenes that they were not chosen on. The bounds that tell best on all scenes are told, for
    `scoup query --presence` and `scoup select --presence`.
    """

    seed: int = 0
    """Of the codebook's start."""

    def run(self, console: Console) -> None:
        """Ask, judge, write."""
        from scoup.base.errors import InputError
        from scoup.evaluate.scoring import encode_words, text_source
        from scoup.evaluate.studies.presence import absent_words, ask_scene, presence_tables
        from scoup.uplift.build_settings import build_settings

        self.check("presence")
        scenes = self.prepared(console)
        if len(scenes) < 2:
            raise InputError("each scene is judged by a bound chosen on others; give two scenes or more")
        asked = []
        for scene in scenes:
            words = absent_words(scene.scene, [other.scene for other in scenes if other is not scene])
            source = text_source(self.root, scene.scene, self.text, CLIP_MODEL)
            asked.append(encode_words(words, source, f"which is asked of {scene.name} as absent"))
        settings = build_settings(seed=self.seed)
        questions = []
        with console.progress() as progress:
            for scene, absent in zip(scenes, asked, strict=True):
                questions += ask_scene(scene, absent.vectors, absent.everyday, settings, progress=progress)
        tables, record = presence_tables(questions)
        self.write(console, "presence", tables, "Presence", record)
        for verb, bound in record["bounds"].items():
            console.say(f"tells best on these scenes: scoup {verb} --presence {bound:.2f}")
