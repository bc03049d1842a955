"""A robot's camera: frames arrive one by one, and the field answers in between, in memory that does not grow.

    python examples/10_robot_stream.py demo/scene demo/scene/text.npz teapot 20 300

The numbers are how many of the newest frames the field knows (the window), and frames in all. A frame is a camera with
its regions. Here the cameras of a scene come round again and again; on a robot they come from its localisation, and the
regions from `scoup.extract` or your own segmenter. The codebook is learned from the first window.
"""

import sys
from dataclasses import replace
from statistics import median
from time import perf_counter

import scoup
from scoup_lab.bench.measuring import resident_bytes

scene, words, thing = sys.argv[1:4]
window, n_frames = map(int, sys.argv[4:6])

gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
regions = scoup.load_regions(scene, cameras)


def frame(number):
    """What arrives: a camera under a name of its own, and its regions at each level."""
    camera = cameras[number % len(cameras)]
    maps = {level: regions.load(camera.name, level) for level in regions.levels}
    return replace(camera, name=f"frame_{number:06d}"), maps


first = [frame(number) for number in range(window)]
known = scoup.Regions.from_maps({camera.name: maps for camera, maps in first})
sums = scoup.RegionSums.empty(gaussians, known.levels)
field = scoup.build(gaussians, scoup.Cameras(camera for camera, _ in first), known, words=words, sums=sums)

updates, answers, memory = [], [], []
for number in range(window, n_frames):
    camera, maps = frame(number)
    started = perf_counter()
    field = scoup.update(
        field,
        sums,
        add=[camera],
        regions=scoup.Regions.from_maps({camera.name: maps}),
        remove=[f"frame_{number - window:06d}"],
        check_fit=False,  # the build has looked whether splat and cameras belong together
    )
    updated = perf_counter()
    place = field.location(thing)
    answers.append(perf_counter() - updated)
    updates.append(updated - started)
    memory.append(resident_bytes() or 0)
    if (number - window) % 50 == 0:
        where = "not there" if place.position is None else [round(x, 3) for x in place.position.tolist()]
        print(f"{camera.name}: where is the {thing}? {where}, {place.answer.remark()}")

for what, seconds in (("update", updates), ("answer", answers)):
    print(f"{what}: median {median(seconds) * 1e3:.0f} ms, worst {max(seconds) * 1e3:.0f} ms")
print(f"resident memory: {memory[0] / 1e6:.0f} MB at the first frame, {memory[-1] / 1e6:.0f} MB at the last")
print(f"{len(sums)} views in {sums.bytes / 1e6:.1f} MB of region sums")
