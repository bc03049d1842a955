"""scoup eval lerf-ovs, 3d-ovs, mipnerf360, ref-lerf: one data set by its own protocol."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal

from scoup.cli.console import Console
from scoup.cli.options import Flag, OptionalInteger, OptionGroups
from scoup_lab.cli.evaluate.options import DataSetOptions, Rules


@dataclass(frozen=True, kw_only=True)
class Scored(DataSetOptions):
    """Options of the protocols."""

    option_groups: ClassVar[OptionGroups] = {
        "scoring": "rules selection",
        "build": "preset n_atoms k seed rebuild",
        "output": "sheets",
    }

    rules: Rules = "scoup"
    """Whose constants turn relevancy into masks and points; langsplat names none but for LERF-OVS, whose rules Ref-LERF
    takes."""
    preset: Literal["default", "paper"] = "default"
    """How fields are built: default answers best, paper is the method as published (Adam, slow)."""
    n_atoms: OptionalInteger = None
    """Atoms in the codebook of each level (L). Default: the preset's."""
    k: OptionalInteger = None
    """Atoms in the code of a region (K). Default: the preset's."""
    seed: int = 0
    """Seed of the codebook's start."""
    rebuild: Flag = False
    """Build anew the fields that are there already."""
    selection: Flag = False
    """Also score by the 3D-selection protocol, in tables of its own."""
    sheets: Literal["worst", "none"] = "worst"
    """Pictures of the worst answered queries of each scene."""

    data_set_name: ClassVar[str]

    def run(self, console: Console) -> None:
        """Build what is missing, predict, score, write."""
        from scoup.uplift.build_settings import build_settings
        from scoup_lab.bench.environment import describe_environment
        from scoup_lab.evaluate.data_sets import find_data_set
        from scoup_lab.evaluate.evaluation import EvaluationSettings, evaluate_scene, write_reports

        settings = EvaluationSettings(
            find_data_set(self.data_set_name),
            self.rules,
            build_settings(self.preset, n_atoms=self.n_atoms, k=self.k, seed=self.seed),
            self.rebuild,
            self.selection,
            self.sheets == "worst",
            self.device,
        )
        out = self.out or Path(f"eval_{self.data_set_name}")
        settings.check_outputs(out, self.overwrite)
        scenes = self.open_scenes(console, self.data_set_name)
        console.kept = lambda: _kept(out)
        with console.progress() as progress:
            evaluations = [
                evaluate_scene(scene, self.text_source(scene), out, settings, progress, console.say)
                for scene in scenes
            ]
        described = {"environment": describe_environment(), "root": str(self.root)}
        records = write_reports(evaluations, out, described, settings, self.overwrite)
        for stem in records:
            for table in (out / f"{stem}.md").read_text(encoding="utf-8").split("## ")[1:3]:
                console.say("\n" + table.strip())
        drawn = ", failures" if settings.sheets else ""
        console.say(f"\n{out}: tables (.md, .json, .tex), fields, cache{drawn}")
        console.result({"out": out, "reports": records})


def _kept(out: Path) -> str:
    """What an interruption leaves, in words."""
    if not out.is_dir():
        return "nothing was written"
    return f"fields and predictions so far are kept in {out}, run the same command again to continue"


@dataclass(frozen=True, kw_only=True)
class LerfOvs(Scored):
    """Score LERF-OVS (figurines, ramen, teatime, waldo_kitchen): masks and points, with the rules of its protocol.

    Builds the fields that are missing, predicts once into a cache, and writes tables by query, by scene and overall,
    with intervals, published figures marked as such, and the worst answers as pictures.
    """

    data_set_name: ClassVar[str] = "lerf-ovs"


@dataclass(frozen=True, kw_only=True)
class ThreeDOvs(Scored):
    """Score 3D-OVS (bed, bench, room, sofa, lawn): masks, with the rules of its protocol."""

    data_set_name: ClassVar[str] = "3d-ovs"


@dataclass(frozen=True, kw_only=True)
class MipNerf360(Scored):
    """Score Mip-NeRF 360 with the GAGS annotations (room, counter, garden, bonsai): masks, with the rules of its
    protocol."""

    data_set_name: ClassVar[str] = "mipnerf360"


@dataclass(frozen=True, kw_only=True)
class RefLerf(Scored):
    """Score Ref-LERF (figurines, ramen, teatime, waldo_kitchen): masks of what sentences refer to, with the rules of
    LERF-OVS."""

    data_set_name: ClassVar[str] = "ref-lerf"
