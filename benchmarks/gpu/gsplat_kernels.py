"""The rasterisers of an unpacked gsplat compiled without torch and without a GPU.

gsplat's sources include headers of a CUDA build of torch. Its kernels need none of them: the text of a kernel is cut
out at run time and compiled with the headers of gsplat, glm and CUDA only, with the options that gsplat asks for.
"""

from __future__ import annotations

import re
import subprocess
from dataclasses import dataclass
from pathlib import Path

from benchmarks.gpu.timing import Unavailable

SOURCES = Path("gsplat") / "cuda"
FORWARD, BACKWARD = "RasterizeToPixels3DGSFwd.cu", "RasterizeToPixels3DGSBwd.cu"
TILE = 16  # gsplat's default: a block draws 16 x 16 pixels, one a thread
WARPS = TILE * TILE // 32
OPTIONS = (
    "-O3",
    "-use_fast_math",
    "-std=c++17",
    "--expt-relaxed-constexpr",
    "-w",
)  # as gsplat's _backend.py asks
_KERNEL = re.compile(r"template\s*<\s*uint32_t CDIM,[^>]*>\s*__global__\s+void\s+(\w+)\s*\(")
_HEAD = """#include <cooperative_groups.h>
#include "Common.h"
#include "Utils.cuh"
namespace gsplat {{
namespace cg = cooperative_groups;
// As torch defines it for float.
inline __device__ float gpuAtomicAdd(float *address, float value) {{ return atomicAdd(address, value); }}
{kernel}
{uses}
}}
"""


@dataclass(frozen=True)
class Peer:
    """One of gsplat's kernels at several numbers of channels.

    Attributes:
        name: in the table.
        source: its file.
        channels: numbers of them.
        absent: pointers that are null here whatever is passed: what hangs on them is then not compiled.
        staged: whether the block keeps the values of its Gaussians in shared memory.
    """

    name: str
    source: str
    channels: tuple[int, ...]
    absent: tuple[str, ...] = ()
    staged: bool = False

    def shared(self, channels: int) -> int:
        """Bytes of a block, as gsplat's launch asks for: for each thread number, centre, opacity and conic of a
        Gaussian, and its values where they are staged.
        """
        return TILE * TILE * (4 + 12 + 12 + (4 * channels if self.staged else 0))


# What dense uplift never passes: backgrounds, and where gradients' absolute values go.
UNASKED = ("backgrounds", "v_means2d_abs")
PEERS = (
    Peer("gsplat, forward", FORWARD, (3, 32, 64, 128, 512)),
    Peer("gsplat, backward", BACKWARD, (32, 128), staged=True),
    Peer("gsplat, backward as dense uplift asks", BACKWARD, (32, 128), UNASKED, staged=True),
)


def cut_kernel(text: str) -> tuple[str, str]:
    """The first kernel with a number of channels in a source file: its name, and its text from ``template`` to the
    closing brace.

    Raises:
        Unavailable: there is none.
    """
    text = re.sub(r"//[^\n]*", "", text)  # braces in comments close nothing
    start = _KERNEL.search(text)
    begins = re.compile(r"\)\s*\{").search(text, start.end()) if start else None
    if start is None or begins is None:
        raise Unavailable("holds no kernel of CDIM channels; gsplat 1.5.3 is what is known here")
    depth = 0
    for place in range(begins.end() - 1, len(text)):
        depth += {"{": 1, "}": -1}.get(text[place], 0)
        if depth == 0:
            return start[1], text[start.start() : place + 1]
    raise Unavailable(f"the text of {start[1]} does not end")


def compile_peer(peer: Peer, gsplat: Path, nvcc: Path, capability: int, folder: Path) -> Path:
    """The binary, in ``folder``.

    Args:
        peer: which kernel.
        gsplat: the folder that gsplat is unpacked or installed in, which holds gsplat/cuda/csrc.
        nvcc: CUDA's compiler.
        capability: 80 for an A100, 90 for an H100.
        folder: for what is compiled.

    Raises:
        Unavailable: the source is not there or not as expected, or nvcc refuses it.
    """
    cuda = gsplat / SOURCES
    source = cuda / "csrc" / peer.source
    if not source.is_file():
        raise Unavailable(f"{source} is missing: give the folder that holds {SOURCES}")
    try:
        name, kernel = cut_kernel(source.read_text())
    except Unavailable as error:
        raise Unavailable(f"{source} {error}") from error
    body = re.compile(r"\)\s*\{").search(kernel)
    assert body is not None
    absent = "".join(f" {pointer} = nullptr;" for pointer in peer.absent)
    kernel = kernel[: body.end()] + absent + kernel[body.end() :]
    uses = "\n".join(f"auto *use_{channels} = &{name}<{channels}, float>;" for channels in peer.channels)
    unit, binary = folder / "peer.cu", folder / "peer.cubin"
    unit.write_text(_HEAD.format(kernel=kernel, uses=uses))
    include = (cuda / "include", cuda / "csrc", cuda / "csrc" / "third_party" / "glm")
    command = [str(nvcc), "-cubin", f"-arch=sm_{capability}", *OPTIONS, *(f"-I{one}" for one in include)]
    try:
        done = subprocess.run(
            [*command, str(unit), "-o", str(binary)], capture_output=True, text=True, check=False
        )
    except OSError as error:
        raise Unavailable(f"{nvcc} does not run: {error.strerror}") from error
    if done.returncode:
        lines = (done.stderr or done.stdout).strip().splitlines()
        raise Unavailable(f"nvcc fails: {lines[0] if lines else done.returncode}")
    return binary


def versions(gsplat: Path, nvcc: Path) -> str:
    """Of both, as far as they tell."""
    file = gsplat / "gsplat" / "version.py"
    own = re.search(r"__version__\s*=\s*[\"']([^\"']+)", file.read_text()) if file.is_file() else None
    try:
        told = subprocess.run([str(nvcc), "--version"], capture_output=True, text=True, check=False).stdout
    except OSError:
        told = ""
    compiler = re.search(r"\bV(\d[\d.]*)", told)
    return f"gsplat {own[1] if own else 'of unknown version'}, nvcc {compiler[1] if compiler else 'of unknown version'}"


def channels_of(function: str) -> int | None:
    """Of a function's name in the binary."""
    found = re.search(r"_kernelILj(\d+)E", function)
    return int(found[1]) if found else None
