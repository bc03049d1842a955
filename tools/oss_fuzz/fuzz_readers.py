"""Target of OSS-Fuzz: the first byte of an input names a reader of ``benchmarks.hostile``, the rest is the file.

fuzz_readers.py [OPTION OF LIBFUZZER ...] [CORPUS]
fuzz_readers.py --seeds FOLDER      # valid files, to begin with
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))


def main(arguments: list[str]) -> None:
    """Write seeds, or read files that libFuzzer makes, in this process, which it ends."""
    if arguments[:1] == ["--seeds"]:
        write_seeds(Path(arguments[1]))
        return
    from benchmarks.hostile.guided import instrumenter

    atheris = instrumenter()
    with atheris.instrument_imports(include=["scoup"]):
        reads = readings()

    def read(content: bytes) -> None:
        if content:
            reads[content[0] % len(reads)](content[1:])

    atheris.Setup([sys.argv[0], *arguments], read)
    atheris.Fuzz()


def readings() -> list[Any]:
    """Return a function of the bytes of a file for each reader whose code is Python."""
    from benchmarks.hostile.guided import reading
    from benchmarks.hostile.readers import READERS
    from benchmarks.hostile.samples import write_samples
    from benchmarks.hostile.study import IN_PYTHON

    folder = Path(tempfile.mkdtemp(prefix="fuzz-files-"))
    write_samples(folder / "valid")
    found = []
    for number, name in enumerate(IN_PYTHON):  # a folder each: what one damages, the next one would find
        copied = shutil.copytree(folder / "valid", folder / str(number))
        found.append(reading(READERS[name], copied))
    return found


def write_seeds(folder: Path) -> None:
    """Write the valid files of all readers as inputs."""
    from benchmarks.hostile.readers import READERS
    from benchmarks.hostile.samples import write_samples
    from benchmarks.hostile.study import IN_PYTHON

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fuzz-files-") as samples:
        write_samples(Path(samples))
        for number, name in enumerate(IN_PYTHON):
            reader = READERS[name]
            for place, file in enumerate((reader.file, *reader.more)):
                sample = Path(samples) / file
                content = sample.read_bytes() if sample.is_file() else b""
                (folder / f"{number}-{place}").write_bytes(bytes([number]) + content)


if __name__ == "__main__":
    main(sys.argv[1:])
