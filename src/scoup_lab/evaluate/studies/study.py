"""The base of studies: results on scenes, and a report on them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, Generic, TypeVar

from scoup.base import Progress, no_progress
from scoup_lab.evaluate.report import Report
from scoup_lab.evaluate.studies.study_scene import StudyScene

Result = TypeVar("Result")


class Study(ABC, Generic[Result]):
    """Several methods or rules tried on the scenes of one data set. Its fields are what is tried."""

    stem: ClassVar[str]
    """Of the names of the report's files."""

    @abstractmethod
    def results(self, scenes: Sequence[StudyScene], progress: Progress = no_progress) -> list[Result]:
        """Return the results on each scene; ``progress`` is called after each piece of work."""

    @abstractmethod
    def report(self, results: Sequence[Result], protocol: str, described: dict[str, Any]) -> Report:
        """Return tables and record."""
