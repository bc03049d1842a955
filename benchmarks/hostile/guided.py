"""The process in which libFuzzer chooses files for a reader by the code that they reach (``study.Guided``).

    python -m benchmarks.hostile.guided TABLE READER CORPUS FAILURES RUNS SEED

Nothing of scoup may be imported before it is instrumented.
"""

from __future__ import annotations

import importlib
import sys
import tempfile
from pathlib import Path
from typing import Any

_LARGEST = 65_536


def main(table: str, name: str, corpus: str, failures: str, runs: str, seed: str) -> None:
    """Read files that libFuzzer makes, in this process, which it ends."""
    atheris: Any = importlib.import_module("atheris")  # the wheel has no types
    with atheris.instrument_imports(include=["scoup"]):
        module, attribute = table.split(":")
        reader = getattr(importlib.import_module(module), attribute)[name]
        from benchmarks.hostile.samples import write_samples
        from scoup.base.errors import ScoupError
    import warnings

    folder = Path(tempfile.mkdtemp(prefix="guided-files-"))
    write_samples(folder)
    valid = Path(tempfile.mkdtemp(prefix="guided-valid-"))
    for number, file in enumerate((reader.file, *reader.more)):
        sample = folder / file
        (valid / str(number)).write_bytes(sample.read_bytes() if sample.is_file() else b"")
    warnings.simplefilter("ignore")

    def read(content: bytes) -> None:
        (folder / reader.file).write_bytes(content)
        try:
            reader.read(folder)
        except ScoupError as error:
            if "\n" in str(error) or str(folder) not in str(error):
                raise RuntimeError(f"a message of several lines, or without the file: {error}") from error

    flags = [f"-runs={runs}", f"-seed={seed}", f"-max_len={_LARGEST}", f"-artifact_prefix={failures}/"]
    flags += ["-timeout=10", "-rss_limit_mb=2048", "-print_final_stats=0"]
    atheris.Setup(["guided", *flags, corpus, str(valid)], read)
    atheris.Fuzz()


if __name__ == "__main__":
    main(*sys.argv[1:])
