"""Protocols compare with the four canonical phrases and nothing else, however many other words there are."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from torch import Tensor

from evaluate.study_scenes import study_scene
from scoup.models import CANONICAL_PHRASES, WordTable
from scoup.query import build
from scoup.uplift import BuildSettings
from scoup_lab.baselines.autoencoder import AutoencoderSettings
from scoup_lab.baselines.fitted import FittedField, FittedMethod
from scoup_lab.baselines.method import MethodSettings
from scoup_lab.baselines.methods import METHODS
from scoup_lab.evaluate import pixel_evaluation
from scoup_lab.evaluate.label_vectors import encode_labels
from scoup_lab.evaluate.pixel_evaluation import predict
from scoup_lab.evaluate.protocols import selection
from scoup_lab.evaluate.rules import MASK_RULES
from scoup_lab.evaluate.studies.ablation_rows import BASE, BESIDE_EVERYDAY, Ablation, find_ablations
from scoup_lab.evaluate.studies.ablations import Ablations
from scoup_lab.evaluate.studies.comparison import Comparison
from scoup_lab.evaluate.studies.study_scene import StudyScene
from support import unit

BUILD = BuildSettings(n_atoms=8, k=2, effort="fast")
RULE = MASK_RULES["scoup"]
WORDS = ("cup", "pot", *(f"word {number}" for number in range(30)))


class Recorder:
    """A ``FittedMethod`` that keeps what it was compared with."""

    def __init__(self, fitted: FittedMethod) -> None:
        self.fitted, self.given = fitted, list[Tensor]()

    def __getattr__(self, name: str) -> Any:
        if name not in ("relevancy", "gaussian_relevancy"):
            return getattr(self.fitted, name)

        def recorded(*arguments: Any) -> Tensor:
            self.given.append(arguments[2 if name == "relevancy" else 1])
            return getattr(self.fitted, name)(*arguments)

        return recorded


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Tensor]:
    """A word table with thirty everyday words, and the vectors [4, D] of its canonical phrases."""
    words = (*WORDS, *CANONICAL_PHRASES)
    vectors = unit(torch.randn(len(words), 16, generator=torch.Generator().manual_seed(4)))
    path = tmp_path_factory.mktemp("words") / "text.npz"
    WordTable.save(path, words, vectors)
    return path, vectors[-4:]


@pytest.fixture(scope="module")
def scene(table: tuple[Path, Tensor], tmp_path_factory: pytest.TempPathFactory) -> StudyScene:
    folder = tmp_path_factory.mktemp("scene")
    return study_scene("s", folder, lambda labelled, _: encode_labels(labelled, str(table[0])))


def check(given: list[Tensor], canonical: Tensor) -> None:
    assert given
    for each in given:
        torch.testing.assert_close(each, canonical, atol=1e-6, rtol=0)


def test_labels_are_read_with_four_phrases(scene: StudyScene, table: tuple[Path, Tensor]) -> None:
    check([scene.vectors.canonical], table[1])
    assert len(scene.vectors.everyday) == len(WORDS)
    assert len(scene.vectors.with_everyday().canonical) == 5  # there are enough words for a fifth


def test_evaluation(scene: StudyScene, table: tuple[Path, Tensor], monkeypatch: pytest.MonkeyPatch) -> None:
    """Of fields, in 2D and by selection."""
    rasterised = scene.rasterised
    built = build(rasterised.gaussians, rasterised.cameras, rasterised.regions, settings=BUILD)
    recorder: Any = Recorder(FittedField(built))
    monkeypatch.setattr(pixel_evaluation, "FittedField", lambda _: recorder)
    maps = list(predict(scene.labelled, scene.vectors, built))
    assert len(maps) == len(recorder.given) == 2
    selection.score_method(scene.labelled, scene.vectors, recorder, rasterised.gaussians, "inria")
    assert len(recorder.given) == 4
    check(recorder.given, table[1])
    for frame, found in maps:
        camera = rasterised.cameras[frame.name]
        expected = built.relevancy(camera, scene.vectors.of(frame.labels), table[1])
        torch.testing.assert_close(found.float(), expected, atol=2e-3, rtol=0)


@pytest.mark.parametrize("name", ["sparse", "dense", "centre-pixel", "top-45-contributors", "autoencoder"])
def test_comparison_of_methods(
    scene: StudyScene, table: tuple[Path, Tensor], name: str, tmp_path: Path
) -> None:
    method, recorders = METHODS[name], []

    def uplift(inputs, settings):
        recorders.append(Recorder(method.uplift(inputs, settings)))
        return recorders[-1]

    settings = MethodSettings(build=BUILD, autoencoder=AutoencoderSettings(epochs=1))
    Comparison([replace(method, uplift=uplift)], RULE, tmp_path, settings, selection=True).results([scene])
    check(recorders[0].given, table[1])


def test_ablations(scene: StudyScene, table: tuple[Path, Tensor]) -> None:
    """But for the one row that is about everyday words."""
    recorders = []

    def uplift(inputs, settings):
        recorders.append(Recorder(BASE.uplift(inputs, settings)))
        return recorders[-1]

    method = replace(BASE, uplift=uplift)
    rows = [replace(each, method=method) for each in find_ablations(["levels"]) if each.method is BASE]
    settings = (RULE, (0,), 2)
    Ablations(rows, *settings).results([scene])
    check(recorders[0].given, table[1])
    everyday = Ablation("beside everyday words", "phrases", method, BESIDE_EVERYDAY)
    Ablations([everyday], *settings).results([scene])
    assert {len(each) for each in recorders[1].given} == {5}
