"""Target of OSS-Fuzz: the first byte of an input names a reader of ``tests.fuzzing``, the rest makes the file.

fuzz_readers.py [OPTION OF LIBFUZZER ...] [CORPUS ...]
fuzz_readers.py --seeds FOLDER      # valid files, to begin with

Without OSS-Fuzz it needs `pip install atheris`. What tests/fuzzing/target.py raises is a failure. Nothing of scoup may
be imported before it is instrumented.
"""

from __future__ import annotations

import importlib
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
IN_PYTHON = (
    "ply", "ascii ply", "compressed ply", "splat", "spz", "glb", "gltf", "cameras.bin", "images.bin", "cameras.txt",
    "images.txt", "points3D.txt", "transforms.json", "cameras.json", "cfg_args", "config.yml", "cfg.yml",
    "region labels", "regions", "regions.json", "field", "region sums", "words.json",
)  # fmt: skip
"""Readers whose code is Python, so that coverage guides their inputs."""


def main(arguments: list[str]) -> None:
    """Write seeds, or read files that libFuzzer makes, in this process, which it ends."""
    if arguments[:1] == ["--seeds"]:
        write_seeds(Path(arguments[1]))
        return
    atheris = instrumenter()
    with atheris.instrument_imports(include=["scoup"]):
        targets = all_targets()

    def read(content: bytes) -> None:
        if content:
            targets[content[0] % len(targets)](content[1:])

    atheris.Setup([sys.argv[0], *arguments], read)
    atheris.Fuzz()


def instrumenter() -> Any:
    """Return atheris, which then instruments the sources of this checkout.

    What finds them for an editable install comes last from now on: atheris does not see the code that it imports.
    """
    sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "src"))
    sys.meta_path.sort(key=lambda finder: type(finder).__module__.startswith("_editable_"))
    return importlib.import_module("atheris")  # the wheel has no types


def all_targets() -> list[Any]:
    """Return a function of the rest of an input for each reader whose code is Python."""
    from tests.fuzzing.readers import READERS
    from tests.fuzzing.samples import write_samples
    from tests.fuzzing.target import target_of

    folder = Path(tempfile.mkdtemp(prefix="fuzz-files-"))
    write_samples(folder / "valid")
    found = []
    for number, name in enumerate(IN_PYTHON):  # a folder each: what one damages, the next one would find
        copied = shutil.copytree(folder / "valid", folder / str(number))
        found.append(target_of(READERS[name], copied))
    return found


def write_seeds(folder: Path) -> None:
    """Write inputs that make the valid files of all readers, whole and part by part."""
    from tests.fuzzing.readers import READERS
    from tests.fuzzing.samples import write_samples
    from tests.fuzzing.target import seeds_of

    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="fuzz-files-") as samples:
        write_samples(Path(samples))
        for number, name in enumerate(IN_PYTHON):
            for place, seed in enumerate(seeds_of(READERS[name], Path(samples))):
                (folder / f"{number}-{place}").write_bytes(bytes([number]) + seed)


if __name__ == "__main__":
    main(sys.argv[1:])
