"""Build a field with Ray: the region sums in parts, each on whichever machine is free, then the field.

    python examples/10_parts_with_ray.py demo/scene demo/scene/text.npz 8 ray.scoup

Arguments: a scene folder, a word table or a CLIP model, how many parts, and the field to write. Needs `pip install
ray`, scoup on every machine, and one folder of the scene and the field for all of them. After a failure, run it again:
views that are done are not made again.
"""

import subprocess
import sys
from pathlib import Path

import ray  # pyright: ignore[reportMissingImports]

if len(sys.argv) < 5:
    sys.exit(__doc__)
scene, words, count, field = sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]).absolute()
scene, words = str(Path(scene).absolute()), str(Path(words).absolute()) if Path(words).exists() else words
sums = f"{field}.sums"


def make_part(number: int) -> None:
    done = subprocess.run(["scoup", "build", scene, "--keep-sums", sums, "--part", f"{number}/{count}"])
    # Killed, as when memory runs out: Ray tries again, on another machine if it likes.
    if done.returncode < 0:
        raise ChildProcessError(f"part {number} was ended by signal {-done.returncode}")
    done.check_returncode()


ray.init()
# num_cpus: threads of a part; num_gpus=1 and --device cuda for a GPU each
task = ray.remote(make_part).options(num_cpus=1, max_retries=3, retry_exceptions=[ChildProcessError])
ray.get([task.remote(number) for number in range(1, count + 1)])
subprocess.run(["scoup", "build", scene, "--sums", sums, "--out", field, "--model", words], check=True)
