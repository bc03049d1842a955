"""Target of OSS-Fuzz: the first byte of an input names a reader of ``benchmarks.hostile``, the rest is the file.

fuzz_readers.py [OPTION OF LIBFUZZER ...] [CORPUS ...]
fuzz_readers.py --seeds FOLDER      # valid files, to begin with

Without OSS-Fuzz it needs `pip install atheris`. An exception that is no ScoupError, or a message that is not one line
with the file in it, is a failure. Nothing of scoup may be imported before it is instrumented.
"""

from __future__ import annotations

import importlib
import shutil
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
IN_PYTHON = (
    "ply", "ascii ply", "compressed ply", "splat", "spz", "glb", "gltf", "cameras.bin", "images.bin", "cameras.txt",
    "images.txt", "points3D.txt", "transforms.json", "cameras.json", "cfg_args", "config.yml", "cfg.yml",
    "region labels", "regions", "regions.json", "field", "region sums", "shards", "words.json",
)  # fmt: skip


def main(arguments: list[str]) -> None:
    """Write seeds, or read files that libFuzzer makes, in this process, which it ends."""
    if arguments[:1] == ["--seeds"]:
        write_seeds(Path(arguments[1]))
        return
    atheris = instrumenter()
    with atheris.instrument_imports(include=["scoup"]):
        reads = readings()

    def read(content: bytes) -> None:
        if content:
            reads[content[0] % len(reads)](content[1:])

    atheris.Setup([sys.argv[0], *arguments], read)
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
        reader: of ``benchmarks.hostile.readers``.
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


def readings() -> list[Any]:
    """Return a function of the bytes of a file for each reader whose code is Python."""
    from benchmarks.hostile.readers import READERS
    from benchmarks.hostile.samples import write_samples

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
