"""Evaluation of a data set by its protocol: the field of each scene is built, scored, and reported on."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Generic, TypeVar

from scoup.base import InputError, Progress, no_progress, reserved_output
from scoup.io import load_gaussians, load_regions, splat_source
from scoup.query import LanguageField
from scoup.scene import Gaussians
from scoup.uplift import BuildSettings, FieldSources, build, cameras_with_regions, embedding_source, open_sums
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.scenes import SceneFiles

Scene = TypeVar("Scene", bound=SceneFiles)
Result = TypeVar("Result")
Say = Callable[[str], None]


def say_nothing(_: str) -> None:
    """Drop a sentence."""


@dataclass(frozen=True, kw_only=True)
class Evaluation(ABC, Generic[Scene, Result]):
    """The evaluation of a data set."""

    build: BuildSettings  # of the fields
    device: str = "cpu"  # where tensors live

    @property
    @abstractmethod
    def stems(self) -> Sequence[str]:
        """Stems of the names of the reports' files."""

    @abstractmethod
    def scene(
        self, scene: Scene, source: str, out: Path, progress: Progress = no_progress, say: Say = say_nothing
    ) -> Result:
        """Build what is missing of a scene, and score it."""

    @abstractmethod
    def reports(self, results: dict[str, Result], described: dict[str, Any]) -> list[Report]:
        """Return the reports on scenes by name; ``described`` goes into the records: the data set, the machine."""

    def field(
        self, scene: SceneFiles, path: Path, source: str, progress: Progress = no_progress
    ) -> LanguageField:
        """Return the field of a scene: read where it is built already, else built and saved."""
        gaussians = load_gaussians(scene.splat).to(self.device)
        # Which constants the rasteriser uses follows from the splat.
        settings = replace(self.build, raster_preset=splat_source(scene.splat).preset)
        if path.is_file():
            return _stored(path, gaussians, settings)
        regions = load_regions(scene.features, scene.cameras)
        model, words = embedding_source(scene.features, regions, source)
        views = cameras_with_regions(scene.cameras, regions)
        with reserved_output(path, overwrite=True) as work:
            if path.is_file():  # another process has built it meanwhile
                return _stored(path, gaussians, settings)
            field = build(
                gaussians,
                scene.cameras,
                regions,
                settings=settings,
                sources=FieldSources(model, words, scene.splat),
                sums=open_sums(work / "sums", gaussians, regions, settings, views),
                progress=progress,
            )
            field.save(path, overwrite=True)
        return _stored(path, gaussians, settings)  # what is scored is what is stored, half precision included


def _stored(path: Path, gaussians: Gaussians, settings: BuildSettings) -> LanguageField:
    """Return a field that is built already, on the device of its Gaussians."""
    field = LanguageField.load(path, gaussians).to(gaussians.device)
    if field.info.provenance.get("settings") != settings.to_dict():
        raise InputError(f"{path}: was built with other settings; use another folder, or remove the field")
    return field
