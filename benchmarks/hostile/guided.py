"""The process in which libFuzzer chooses files for a reader by the code that they reach (``study.Guided``).

    python -m benchmarks.hostile.guided TABLE READER CORPUS FAILURES RUNS SEED

Nothing of scoup may be imported before it is instrumented.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

_LARGEST = 65_536


def main(table: str, name: str, corpus: str, failures: str, runs: str, seed: str) -> None:
    """Read files that libFuzzer makes, in this process, which it ends."""
    atheris = instrumenter()
    with atheris.instrument_imports(include=["scoup"]):
        module, attribute = table.split(":")
        reader = getattr(importlib.import_module(module), attribute)[name]
        from benchmarks.hostile.samples import write_samples

    folder = Path(tempfile.mkdtemp(prefix="guided-files-"))
    write_samples(folder)
    valid = Path(tempfile.mkdtemp(prefix="guided-valid-"))
    for number, file in enumerate((reader.file, *reader.more)):
        sample = folder / file
        (valid / str(number)).write_bytes(sample.read_bytes() if sample.is_file() else b"")
    flags = [f"-runs={runs}", f"-seed={seed}", f"-max_len={_LARGEST}", f"-artifact_prefix={failures}/"]
    flags += ["-timeout=10", "-rss_limit_mb=2048", "-print_final_stats=0"]
    atheris.Setup(["guided", *flags, corpus, str(valid)], reading(reader, folder))
    atheris.Fuzz()


def instrumenter() -> Any:
    """Return atheris, which then instruments the sources of this checkout.

    What finds them for an editable install comes last from now on: atheris does not see the code that it imports.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src"))
    sys.meta_path.sort(key=lambda finder: type(finder).__module__.startswith("_editable_"))
    return importlib.import_module("atheris")  # the wheel has no types


def reading(reader: Any, folder: Path) -> Callable[[bytes], None]:
    """Return what reads the bytes of a damaged file, and raises where the reader misbehaves.

    Args:
        reader: of ``readers``.
        folder: with the samples, in which it finds the file.
    """
    from scoup.base.errors import ScoupError

    def read(content: bytes) -> None:
        (folder / reader.file).write_bytes(content)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                reader.read(folder)
        except ScoupError as error:
            if "\n" in str(error) or str(folder) not in str(error):
                raise RuntimeError(f"a message of several lines, or without the file: {error}") from error

    return read


if __name__ == "__main__":
    main(*sys.argv[1:])
