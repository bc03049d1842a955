"""scoup batch: the fields of many scans, several at a time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar

import tyro

from scoup.base.counts import counted
from scoup.cli.build_options import BuildOptions
from scoup.cli.console import Console, with_options
from scoup.cli.options import OptionalPath, OptionalText, OptionGroups

REPORT = "batch.json"


@dataclass(frozen=True, kw_only=True)
class Batch(BuildOptions):
    """Build the field of every scan in a folder; scans without regions are extracted first.

    The same command resumes: it makes only fields that are missing. A scan that fails stops no other; batch.json in the
    folder of the fields says how each went.
    """

    option_groups: ClassVar[OptionGroups] = {
        "scan": "model segmenter embedder jobs",
        "output": "out archive text",
    }

    scans: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SCANS", help_behavior_hint="")]
    """Folder with a folder per scan: a splat and its scene, as for scoup build."""
    out: Path
    """Folder of the fields, each named as its scan."""
    archive: OptionalPath = None
    """Archive to which the fields are added, for scoup archive."""
    text: Annotated[OptionalText, tyro.conf.arg(metavar="TABLE|MODEL", help_behavior_hint="")] = None
    """Text encoder of the archive, as for scoup archive."""
    jobs: int = 1
    """Scans at a time, each in a process of its own."""
    model: OptionalText = None
    """Model of the region embeddings, as for scoup build."""
    segmenter: OptionalText = None
    """Segmenter for scans without regions, as for scoup extract."""
    embedder: OptionalText = None
    """Embedder for scans without regions, as for scoup extract."""

    def run(self, console: Console) -> int:
        """Build what is missing, add it to the archive, report."""
        from scoup.archive.archive import Archive
        from scoup.base.atomic import reserved_output
        from scoup.base.errors import InputError, ScoupError

        if self.jobs < 1:
            raise InputError(f"--jobs must be 1 or more, got {self.jobs}")
        folders = self._folders()
        archive = None if self.archive is None else Archive(self.archive, self.text)
        records: dict[str, dict[str, Any]] = {}
        with reserved_output(self.out / REPORT, overwrite=True), console.progress() as progress:
            for name, record in self._built(folders):
                file = self.out / f"{name}.scoup"
                if archive is not None and "error" not in record:
                    try:
                        if self.overwrite or _is_older(archive.folder / f"{name}.parquet", file):
                            archive.add(file)
                    except ScoupError as error:
                        record["error"] = with_options(str(error))
                records[name] = record
                self._write(records)
                progress("scans", len(records), len(folders))
                said = record.get("error") or (
                    "was there" if record["kept"] else f"{record['seconds']:.0f} s"
                )
                console.say(f"{name}: {said}")
        failed = [name for name, record in records.items() if "error" in record]
        console.say(f"{self.out}: {counted(len(records) - len(failed), 'field')}, {len(failed)} failed")
        console.result({"out": self.out, "failed": failed, "scans": records})
        return 2 if failed else 0

    def _folders(self) -> list[Path]:
        from scoup.base.errors import InputError, MissingFileError
        from scoup.io.camera_sources import has_cameras

        if not self.scans.is_dir():
            problem = "is a file" if self.scans.exists() else "there is no such folder"
            raise MissingFileError(
                self.scans, f"{problem} (a folder of scans was expected)", "check the path"
            )
        if has_cameras(self.scans):
            raise InputError(
                f"{self.scans}: is a scan, expected a folder of scans; scoup build {self.scans} builds its field"
            )
        folders = sorted(path for path in self.scans.iterdir() if path.is_dir() and path.name[0] != ".")
        if not folders:
            raise MissingFileError(self.scans, "contains no folders of scans", "check the path")
        return folders

    def _built(self, folders: list[Path]) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield name and record of each scan as it is done; an interruption ends the processes."""
        started: list[subprocess.Popen[str]] = []
        with ThreadPoolExecutor(self.jobs) as pool:
            futures = {pool.submit(self._build, folder, started): folder.name for folder in folders}
            try:
                for future in as_completed(futures):
                    yield futures[future], future.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                for process in started:
                    process.terminate()
                raise

    def _build(self, folder: Path, started: list[subprocess.Popen[str]]) -> dict[str, Any]:
        """Build a scan in a process of its own, unless its field is there."""
        file, begun = self.out / f"{folder.name}.scoup", time.perf_counter()
        if file.exists() and not self.overwrite:
            return {"kept": True}
        command = [sys.executable, "-m", "scoup", "build", folder, "--out", file, *self._options(), "--json"]
        cores = str(max(1, (os.cpu_count() or 1) // self.jobs))
        process = subprocess.Popen(
            [str(part) for part in command], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
            env={"OMP_NUM_THREADS": cores, **os.environ},
        )  # fmt: skip
        started.append(process)
        said = _parsed(process.communicate()[0])
        record: dict[str, Any] = {"kept": False, "warnings": said.get("warnings", [])}
        if process.returncode:
            how = f"scoup build ended with code {process.returncode}; run it alone to see why"
            record["error"] = said.get("error", how)
        return {**record, "seconds": round(time.perf_counter() - begun, 2)}

    def _options(self) -> list[str]:
        """Return the options of the build that were passed."""
        passed = ["--device", self.device, *(["--overwrite"] if self.overwrite else [])]
        named = {f"--{name}": getattr(self, name) for name in ("model", "segmenter", "embedder")}
        values = {option: getattr(self, option[2:].replace("-", "_")) for option in self.given()}
        for option, value in {**values, **named}.items():
            if value is not None:
                passed += [option] if value is True else [option, str(value)]
        return passed

    def _write(self, records: dict[str, dict[str, Any]]) -> None:
        from scoup.base.atomic import write_text

        ordered = dict(sorted(records.items()))
        write_text(self.out / REPORT, json.dumps({"scans": ordered}, indent=1) + "\n", overwrite=True)


def _is_older(file: Path, other: Path) -> bool:
    """Tell whether a file is missing or older than another."""
    return not file.exists() or file.stat().st_mtime_ns < other.stat().st_mtime_ns


def _parsed(text: str) -> dict[str, Any]:
    """Return the result that a verb printed; nothing of one that was killed."""
    try:
        return json.loads(text)
    except ValueError:
        return {}
