"""Processor seconds of `scoup query` and `scoup info` on files, the start of Python included."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import scoup
from scoup.field.language_field import LanguageField
from scoup.models.word_table import save_table
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS
from scoup.scene.cameras import Cameras
from scoup.scene.field_info import FieldInfo
from scoup_lab.synthetic.random_scene import clip_like

WORD = "kettle"


def verb_seconds(
    field: LanguageField, cameras: Cameras, threads: int, repeats: int
) -> dict[str, list[float]]:
    """Return user and system seconds of each verb, repetition by repetition; one before is not counted."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_files(field, cameras, folder)
        place = str(folder / "room.scoup")
        asked = [WORD, "--camera", cameras[2].name, "--pictures", "none", "--out", str(folder / "out")]
        verbs = {"scoup query": ["query", place, *asked, "--overwrite"], "scoup info": ["info", place]}
        return {
            verb: [_seconds(arguments, threads) for _ in range(repeats + 1)][1:]
            for verb, arguments in verbs.items()
        }


def _write_files(field: LanguageField, cameras: Cameras, folder: Path) -> None:
    """Write a splat, a word table and a field of the codes."""
    scoup.save_gaussians(field.gaussians, folder / "room.ply")
    gaussians = scoup.load_gaussians(folder / "room.ply")
    words = list(dict.fromkeys([*CANONICAL_PHRASES, WORD, *EVERYDAY_WORDS]))
    save_table(folder / "words.npz", words, clip_like(len(words), seed=3), model="simulated")
    info = FieldInfo(
        field.levels, "simulated", gaussians.fingerprint(), len(gaussians), words=folder / "words.npz"
    )
    codes = field.code_indices, field.code_weights, field.codebook
    LanguageField(*codes, info, gaussians, folder / "room.ply", cameras).save(folder / "room.scoup")


def _seconds(arguments: list[str], threads: int) -> float:
    command = [sys.executable, "-c", "from scoup.cli.app import entry; entry()", *arguments]
    environment = os.environ | {"OMP_NUM_THREADS": str(threads)}
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # an installed program's byte code is written once
    before = os.times()
    subprocess.run(command, env=environment, check=True, stdout=subprocess.DEVNULL)
    after = os.times()
    return after.children_user - before.children_user + after.children_system - before.children_system
