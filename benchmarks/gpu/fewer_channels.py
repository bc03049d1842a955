"""Have an installed gsplat compile for the numbers of channels asked for here only: minutes become one.

    python -m benchmarks.gpu.fewer_channels FOLDER     # the folder gsplat is installed in, which holds gsplat/cuda/csrc

Its rasterisers are compiled for 19 numbers of channels, 513 the largest, and those take longest. What is left out is
the lines that ask for them: no kernel is changed. Meant for a copy on a borrowed machine (``pip install --target
FOLDER``); renders of other numbers of channels then fail there.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

KEPT = (3, 8, 32, 64, 128)  # 8: of the 40 channels with which it is tried
ASKED = re.compile(r"^[ \t]*(?:__INS__|__LAUNCH_KERNEL__)\((\d+)\)[ \t]*;?[ \t]*\n", re.MULTILINE)


def fewer_channels(folder: Path, kept: tuple[int, ...] = KEPT) -> int:
    """Take the lines out; how many there were."""
    removed = 0
    for file in sorted((folder / "gsplat" / "cuda" / "csrc").glob("*.c*")):
        before = file.read_text()
        after = ASKED.sub(lambda line: line[0] if int(line[1]) in kept else "", before)
        if after != before:
            removed += before.count("\n") - after.count("\n")
            file.write_text(after)
    return removed


if __name__ == "__main__":
    if len(sys.argv) != 2 or not (Path(sys.argv[1]) / "gsplat" / "cuda" / "csrc").is_dir():
        sys.exit("give the folder that gsplat is installed in (it holds gsplat/cuda/csrc)")
    print(f"{fewer_channels(Path(sys.argv[1]))} lines taken out; channels left: {KEPT}")
