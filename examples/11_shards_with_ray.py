"""Build a field in shards with Ray, each on whichever machine is free, and merge them.

    python examples/11_shards_with_ray.py demo/scene demo/scene/text.npz 8 ray.scoup

Arguments: a scene folder, a word table or a CLIP model, how many shards, and the field to write. Needs `pip install
ray`, scoup on every machine, and one folder of the scene and the field for all of them. After a failure, run it again:
shards that are there are passed over, and an interrupted one goes on where it stopped.
"""

import subprocess
import sys
from pathlib import Path

import ray  # pyright: ignore[reportMissingImports]

scene, words, count, field = sys.argv[1], sys.argv[2], int(sys.argv[3]), Path(sys.argv[4]).absolute()
scene, words = str(Path(scene).absolute()), str(Path(words).absolute()) if Path(words).exists() else words


def make_shard(number: int) -> str:
    path = f"{field}.{number}-of-{count}.sums"
    if not Path(path).exists():  # a folder of this name is whole
        command = ["scoup", "build", scene, "--out", field, "--model", words, "--shard", f"{number}/{count}"]
        done = subprocess.run(command)
        # Killed, as when memory runs out: Ray tries again, on another machine if it likes.
        if done.returncode < 0:
            raise ChildProcessError(f"shard {number} was ended by signal {-done.returncode}")
        done.check_returncode()
    return path


ray.init()
# num_cpus: threads of a shard; num_gpus=1 and --device cuda for a GPU each
task = ray.remote(make_shard).options(num_cpus=1, max_retries=3, retry_exceptions=[ChildProcessError])
shards = ray.get([task.remote(number) for number in range(1, count + 1)])
subprocess.run(["scoup", "merge", *shards, "--out", field], check=True)
