"""scoup batch: the fields of many scans, several at a time."""

from __future__ import annotations

import io
import json
import os
import socket
import subprocess
import sys
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import tyro

from scoup.base import (
    InputError,
    MissingFileError,
    ScoupError,
    as_json,
    counted,
    html,
    reserved_output,
    write_text,
)
from scoup.cli.build import Build
from scoup.cli.build_options import BuildOptions, passed_options
from scoup.cli.console import Console, command, with_options
from scoup.cli.options import AllCommon, Model, PhotographMasks, arg, check_number

REPORT, PAGE = "batch.json", "batch.html"
RETRIES = 3  # of a scan whose worker was killed
ANSWERS_WITHIN = 5.0  # seconds, or a cluster is not there
_SCANS = """{% extends "page" %}{% block body %}<table><tr><th>scan<th>field<th>seconds<th>
{% for name, scan in scans.items() %}
<tr><td>{{ name }}<td>{{ "failed" if scan.error is defined else "done" }}<td>{{ scan.seconds | default("was there") }}
<td>{{ scan.error | default(scan.warnings | default([]) | join(" ")) }}
{% endfor %}</table>{% endblock %}"""
Commands: TypeAlias = "Mapping[str, Sequence[str]]"
"""Name of a scan -> arguments of scoup."""
Ended: TypeAlias = "tuple[int, str, float]"
"""Exit code, standard output and seconds of a command."""


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Build the field of every scan in a folder; scans without regions are extracted first.

    The same command resumes: it makes only fields that are missing. A scan that fails stops no other; batch.json and
    batch.html in the folder of the fields say how each went.
    """

    scans: Annotated[tyro.conf.Positional[Path], arg(metavar="SCANS")]
    """Folder with a folder per scan: a splat and its scene, as for scoup build."""
    out: Path
    """Folder of the fields, each named as its scan."""
    archive: Path | None = None
    """Archive to which the fields are added, for scoup archive."""
    text: Model = None
    """Text encoder of the archive, as for scoup archive."""
    jobs: int = 1
    """Scans at a time, each in a process of its own."""
    ray: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Build on the Ray cluster at this address in place of --jobs: a scan per CPU, with --device cuda per GPU. All
    nodes need scoup, and this folder, SCANS and --out under the same paths."""
    hidden: Annotated[PhotographMasks, arg(name="photograph mask")] = PhotographMasks()
    method: Annotated[BuildOptions, arg(name="field")] = BuildOptions()
    common: AllCommon = AllCommon()

    def run(self, console: Console) -> int:
        from scoup.archive import Archive

        check_number("--jobs", self.jobs, 1)
        if self.ray is not None and self.jobs != 1:
            raise InputError("--jobs is for builds without --ray; Ray builds a scan per CPU or GPU")
        folders = self._folders()
        archive = None if self.archive is None else Archive(self.archive, self.text)
        records: dict[str, dict[str, Any]] = {}
        # Ray prints to standard output, too.
        for_json = redirect_stdout(sys.stderr) if self.common.as_json else nullcontext()
        with reserved_output(self.out / REPORT, overwrite=True), console.progress() as progress, for_json:
            for name, record in self._built([folder.name for folder in folders]):
                file = self.out / f"{name}.scoup"
                if archive is not None and "error" not in record:
                    try:
                        added = archive.folder / f"{name}.parquet"
                        if not record["kept"] or not added.exists() or _time(added) < _time(file):
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
        from scoup.io import ScenePaths

        if not self.scans.is_dir():
            problem = "is a file" if self.scans.exists() else "there is no such folder"
            raise MissingFileError(
                self.scans, f"{problem} (a folder of scans was expected)", "check the path"
            )
        if ScenePaths(self.scans).has_cameras:
            raise InputError(
                f"{self.scans}: is a scan, expected a folder of scans; {command('build', self.scans)} builds its field"
            )
        folders = sorted(path for path in self.scans.iterdir() if path.is_dir() and path.name[0] != ".")
        if not folders:
            raise MissingFileError(self.scans, "contains no folders of scans", "check the path")
        return folders

    def _built(self, names: list[str]) -> Iterator[tuple[str, dict[str, Any]]]:
        """Yield name and record of each scan as it is done; existing scans keep their record."""
        report = self.out / REPORT
        before = _parsed(report.read_text("utf-8", "replace") if report.exists() else "").get("scans")
        missing: dict[str, list[str]] = {}
        for name in names:
            file = self.out / f"{name}.scoup"
            if file.exists() and not self.common.overwrite:
                match before.get(name) if isinstance(before, dict) else None:
                    case {"seconds": float(seconds), "warnings": [*said]} if {*map(type, said)} <= {str}:
                        yield name, {"kept": True, "warnings": said, "seconds": seconds}
                    case _:
                        yield name, {"kept": True}
            else:
                if self.ray is None and (problem := self._problem(self.scans / name, file)):
                    yield name, {"kept": False, "warnings": [], "error": problem, "seconds": 0.0}
                    continue
                files = [str(self.scans / name), "--out", str(file)]
                missing[name] = ["build", *files, *self._options(), "--json"]
        ends = _in_processes(missing, self.jobs)
        if self.ray is not None and missing:
            ends = _on_cluster(missing, self.ray, self.common.device)
        for name, (code, text, seconds) in ends:
            said = _parsed(text)
            record: dict[str, Any] = {"kept": False, "warnings": said.get("warnings", [])}
            if code:
                how = f"scoup build ended with code {code}; run it alone to see why"
                record["error"] = said.get("error", how)
            yield name, {**record, "seconds": round(seconds, 2)}

    def _problem(self, scan: Path, out: Path) -> str:
        """Return why a scan cannot be built, as far as that shows before the long work of any; "" if nothing does."""
        from scoup.uplift import fitting_scene

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the build warns again
                Build(scene=fitting_scene(scan), out=out, method=self.method, common=self.common).check()
        except ScoupError as error:
            return with_options(str(error))
        return ""

    def _options(self) -> list[str]:
        """Return the options of the build that were passed."""
        passed = ["--device", self.common.device, "--overwrite"]
        for option, value in {**passed_options(self.hidden), **passed_options(self.method)}.items():
            passed += [option] if value is True else [option, str(value)]
        return passed

    def _write(self, records: dict[str, dict[str, Any]]) -> None:
        ordered = dict(sorted(records.items()))
        write_text(self.out / REPORT, as_json({"scans": ordered}) + "\n", overwrite=True)
        write_text(self.out / PAGE, html(_SCANS, title="Scans", scans=ordered), overwrite=True)


def _in_processes(commands: Commands, jobs: int) -> Iterator[tuple[str, Ended]]:
    """Run commands, some at a time; an interruption ends the processes."""
    started: list[subprocess.Popen[str]] = []
    environment = {"OMP_NUM_THREADS": str(max(1, (os.cpu_count() or 1) // jobs)), **os.environ}

    def run(command: Sequence[str]) -> Ended:
        begun = time.perf_counter()
        process = subprocess.Popen(
            [sys.executable, "-m", "scoup", *command],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env=environment,
        )  # fmt: skip
        started.append(process)
        text = process.communicate()[0]
        return process.returncode, text, time.perf_counter() - begun

    with ThreadPoolExecutor(jobs) as pool:
        futures = {pool.submit(run, command): name for name, command in commands.items()}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in started:
                process.terminate()
            raise


def _on_cluster(commands: Commands, address: str, device: str) -> Iterator[tuple[str, Ended]]:
    """Run commands as tasks of Ray; those of killed workers run again, an interruption ends all."""
    host, _, port = address.rpartition("/")[2].rpartition(":")
    try:
        if port.isdigit():  # others, as auto, are no addresses; Ray itself tries for minutes
            socket.create_connection((host.strip("[]"), int(port)), ANSWERS_WITHIN).close()
    except (OSError, OverflowError) as error:
        problem = (
            f"nothing answers there ({error}); check the address, or start a cluster by ray start --head"
        )
        raise ScoupError(f"--ray {address}: {problem}") from error
    try:
        import ray  # pyright: ignore[reportMissingImports]
        from ray.exceptions import RayError  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ScoupError("--ray needs the package ray: pip install 'scoup[ray]'") from error
    try:
        ray.init(address, log_to_driver=False, configure_logging=False)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise ScoupError(f"--ray {address}: cannot be reached ({error})") from error
    try:
        task = ray.remote(_run_here).options(max_retries=RETRIES, num_gpus=int(device != "cpu"))
        waiting = {task.remote(os.getcwd(), command): name for name, command in commands.items()}
        while waiting:
            (done,), _ = ray.wait([*waiting])
            name = waiting.pop(done)
            try:
                ended = ray.get(done)
            except RayError as error:
                reason = str(error).strip().splitlines()[-1]
                ended = 1, json.dumps({"error": f"its task failed: {reason}"}), 0.0
            yield name, ended
    finally:
        ray.shutdown()


def _run_here(folder: str, command: Sequence[str]) -> Ended:
    """Run a command in this process, which is killed with it."""
    from scoup.cli.app import run

    os.chdir(folder)
    begun, text = time.perf_counter(), io.StringIO()
    with redirect_stdout(text), redirect_stderr(io.StringIO()):
        code = run([*command])
    return code, text.getvalue(), time.perf_counter() - begun


def _time(file: Path) -> int:
    return file.stat().st_mtime_ns


def _parsed(text: str) -> dict[str, Any]:
    """Return the result that a verb printed; nothing of one that was killed, or of a damaged file."""
    try:
        said = json.loads(text)
    except (ValueError, RecursionError):
        return {}
    return said if isinstance(said, dict) else {}
