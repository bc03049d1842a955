"""The compiled core under hostile arrays, Ctrl-C and fork.

What it computes is tested elsewhere; memory and threads, by the fuzzer and the tests of native/tests.
"""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from children import finished, forked
from scoup.base.native import missing_reason, native_core

core: Any = native_core()
pytestmark = pytest.mark.skipif(core is None, reason=str(missing_reason()))

WIDTH, HEIGHT, N = 48, 32, 300


def scene_arrays(count: int = N, seed: int = 0) -> dict[str, np.ndarray]:
    """A cloud in front of the camera."""
    numbers = np.random.default_rng(seed)
    means = numbers.normal(size=(count, 3)).astype(np.float32)
    means[:, 2] += 4
    return {
        "means": means,
        "quats": numbers.normal(size=(count, 4)).astype(np.float32),
        "scales": np.full((count, 3), 0.1, np.float32),
        "opacities": numbers.uniform(0.1, 0.9, count).astype(np.float32),
        "viewmat": np.eye(3, 4),
    }


def project(count: int = N, seed: int = 0, **changed: Any) -> Any:
    """The projection of a scene; arguments of the binding can be replaced by name."""
    arguments: dict[str, Any] = scene_arrays(count, seed)
    arguments |= {"intrinsics": (40.0, 40.0, WIDTH / 2, HEIGHT / 2), "width": WIDTH, "height": HEIGHT}
    arguments |= {"near_alpha_max_stop": (0.2, 0.99, 1e-4), "stop_inclusive": False, "centred_clamp": True}
    arguments |= {"ties": None, "many_views": True, "in_memory": True, "threads": 1} | changed
    of_scene = ("means", "quats", "scales", "opacities", "ties", "many_views", "in_memory")
    scene = core.Scene(**{name: arguments.pop(name) for name in of_scene}, threads=1)
    return core.project(scene, **arguments)


def image_of(projection: Any, threads: int = 1) -> bytes:
    values = np.random.default_rng(1).normal(size=(projection.n_gaussians, 3)).astype(np.float32)
    return b"".join(part.tobytes() for part in core.render_channels(projection, values, threads))


def combinations() -> np.ndarray:
    return np.zeros((HEIGHT, WIDTH), np.int32)


def vote_arrays(count: int = N, entries: int = 1, seed: int = 0) -> dict[str, Any]:
    """Arguments of a vote: each Gaussian has so many entries in one view."""
    numbers = np.random.default_rng(seed)
    gaussian = np.repeat(np.arange(count), entries)
    buckets = np.unique(gaussian // 256).astype(np.uint32)
    starts = np.searchsorted(gaussian, np.append(buckets, len(buckets)) * 256).astype(np.uint32)
    places = (gaussian % 256).astype(np.uint8)
    chosen = numbers.integers(0, 5, len(gaussian)).astype(np.uint16)
    weights = numbers.uniform(size=len(gaussian)).astype(np.float32)
    view = (buckets, starts, places, chosen, weights, np.arange(5, dtype=np.int64)[:, None])
    return {
        "n_gaussians": count,
        "grams": np.eye(8, dtype=np.float32)[None],
        "views": [view],
        "codes": [(np.zeros((5, 2), np.uint8), np.ones((5, 2), np.float32))],
    }


def round_of(vote: Any, count: int = N, threads: int = 1) -> bytes:
    indices, weights = np.zeros((count, 1, 2), np.uint8), np.zeros((count, 1, 2), np.float32)
    vote.round(indices, weights, None, False, 0, vote.n_buckets, threads)
    return indices.tobytes() + weights.tobytes()


# ---- Arrays

SPOILED = {
    "another dtype": lambda a: a.astype(np.float16),
    "dimensions": lambda a: a.reshape(1, *a.shape),
    "entries": lambda a: np.concatenate([a, a], -1),
    "not contiguous": lambda a: np.repeat(a, 2, -1)[..., ::2],
    "not aligned": lambda a: np.frombuffer(b"\0" + a.tobytes(), a.dtype, a.size, 1).reshape(a.shape),
}


@pytest.mark.parametrize("name", ["means", "quats", "scales", "opacities", "viewmat"])
def test_arrays_that_do_not_fit_are_refused_by_name(name):
    array: Any = scene_arrays()[name]
    for why, spoil in SPOILED.items():
        spoiled: Any = {name: spoil(array)}
        with pytest.raises(ValueError, match=f"^{name} must be .*{why}"):
            project(**spoiled)
    others: list[Any] = [array.astype(array.dtype.newbyteorder(">")), array.astype(str), array.tolist(), None]
    for other in others:
        with pytest.raises(TypeError, match=f"{name}: ndarray"):
            project(**{name: other})


def test_read_only_arrays_are_read_and_not_written():
    read_only = {name: array.copy() for name, array in scene_arrays().items()}
    for array in read_only.values():
        array.flags.writeable = False
    assert image_of(project(**read_only)) == image_of(project())
    weights = WEIGHTS.copy()
    weights.flags.writeable = False
    with pytest.raises(TypeError, match="weights: ndarray"):
        core.Vote(**vote_arrays()).round(INDICES.copy(), weights, None, False, 0, 2, 1)


INDICES, WEIGHTS = np.full((N, 1, 2), 7, np.uint8), np.ones((N, 1, 2), np.float32)


def render_codes(indices: np.ndarray = INDICES, weights: np.ndarray = WEIGHTS, n_atoms: int = 8) -> None:
    core.render_codes(project(), indices, weights, n_atoms, 1)


def vote(**changed: Any) -> Any:
    return core.Vote(**vote_arrays() | changed)


def vote_round(indices: np.ndarray = INDICES, weights: np.ndarray = WEIGHTS, *buckets: int) -> None:
    vote().round(indices, weights.copy(), None, False, *(buckets or (0, 2)), 1)


def vote_of_spoiled(place: int, why: str) -> None:
    view = list(vote_arrays()["views"][0])
    view[place] = SPOILED[why](view[place])
    vote(views=[tuple(view)])


REFUSED: dict[str, tuple[Callable[[], Any], str]] = {
    "no width": (lambda: project(width=0), "image of 0 x 32"),
    "no height": (lambda: project(height=-3), "image of 48 x -3"),
    "width": (lambda: project(width=2**62), "cannot be rendered"),
    "pixels": (lambda: project(width=65535 * 16, height=65535 * 16), "cannot be rendered"),
    "no focal length": (lambda: project(intrinsics=(np.nan, 1.0, 0.0, 0.0)), "focal lengths"),
    "focal length": (lambda: project(intrinsics=(1.0, -1.0, 0.0, 0.0)), "focal lengths"),
    "principal point": (lambda: project(intrinsics=(1.0, 1.0, 0.0, np.inf)), "principal point"),
    "pose": (lambda: project(viewmat=np.full((3, 4), np.nan)), "viewmat must be finite"),
    "near": (lambda: project(near_alpha_max_stop=(np.nan, 0.99, 1e-4)), "near"),
    "alpha": (lambda: project(near_alpha_max_stop=(0.2, 1.5, 1e-4)), "alpha_max"),
    "stop": (lambda: project(near_alpha_max_stop=(0.2, 0.99, np.inf)), "stop"),
    "values": (lambda: core.render_channels(project(), np.zeros((N + 1, 3), np.float32), 1), "^values must be"),
    "no atoms": (lambda: render_codes(n_atoms=0), "atoms"),
    "code weights": (lambda: render_codes(weights=WEIGHTS[:, :, :1].copy()), "^code weights must be"),
    "code indices": (lambda: render_codes(INDICES.astype(np.int64)), "^code indices must be"),
    "grams of cosines": (lambda: core.render_cosines(project(), INDICES, WEIGHTS, np.zeros((1, 8, 9), np.float32),
                                                     np.zeros((1, 8, 5), np.float32), 1), "^grams must be"),
    "rows": (lambda: core.region_sums(project(), combinations()[:-1], 1), "^combinations must be"),
    "integers": (lambda: core.region_sums(project(), combinations().astype(np.int64), 1), "^combinations must be"),
    "levels": (lambda: core.region_sums(project(), combinations()[None], 1), "^combinations must be"),
    "one level": (lambda: core.combine(combinations(), 1), "labels must be"),
    "labels": (lambda: core.combine(np.zeros((2, 3, 4), np.int64), 1), "^labels must be"),
    "grams": (lambda: vote(grams=np.eye(8, dtype=np.float32)[None].repeat(2, 0)), "^grams must be"),
    "empty grams": (lambda: vote(grams=np.zeros((1, 0, 0), np.float32)), "1 to 65536 atoms"),
    "Gaussians": (lambda: vote(n_gaussians=-1), "too many Gaussians"),
    **{f"buckets {first} to {last}": (lambda first=first, last=last: vote_round(INDICES, WEIGHTS, first, last),
       "no such buckets")
       for first, last in ((-1, 1), (1, 0), (0, 3), (2**62, 2**62))},
    "indices": (lambda: vote_round(INDICES.astype(np.uint16)), "^indices must be"),
    "weights": (lambda: vote_round(weights=WEIGHTS[1:]), "^weights must be"),
    "no k": (lambda: vote_round(INDICES[:, :, :0].copy(), WEIGHTS[:, :, :0]), "k at least 1"),
    **{f"array {place} of a view, {why}": (lambda place=place, why=why: vote_of_spoiled(place, why), "must be")
       for place in range(6) for why in ("another dtype", "dimensions")},
}  # fmt: skip


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_what_does_not_fit_is_refused(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_memory_outlives_its_owner():
    image, alpha = core.render_channels(project(), np.ones((N, 1), np.float32), 1)
    kept = alpha.copy()
    vote = core.Vote(**vote_arrays())  # nobody else holds the arrays
    expected = round_of(vote)
    gc.collect()
    assert round_of(vote) == expected
    del vote
    assert np.array_equal(alpha, kept)
    np.testing.assert_allclose(image[..., 0], alpha, atol=1e-5)


# ---- Long calls, and forks


INTERRUPTED = """
import os, sys, threading, time
import numpy as np
sys.path[:0] = [os.environ["TESTS"], os.path.dirname(os.environ["TESTS"])]
from test_native_safety import core, image_of, project, round_of, vote_arrays

projection = project(20000, width=1600, height=1600, intrinsics=(1600.0, 1600.0, 800.0, 800.0))
values, vote = np.ones((20000, 400), np.float32), core.Vote(**vote_arrays(50_000, 200))
known, voted = image_of(project()), round_of(core.Vote(**vote_arrays()))

def interrupt():
    sent.append(time.process_time())
    os.kill(os.getpid(), 2)

for threads in (1, 2):
    for call in (lambda: core.render_channels(projection, values, threads), lambda: round_of(vote, 50_000, threads)):
        sent = []
        threading.Timer(0.1, interrupt).start()
        try:
            while True:
                call()
        except KeyboardInterrupt:
            print(time.process_time() - sent[0])
        assert (image_of(project()), round_of(core.Vote(**vote_arrays()))) == (known, voted)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="signals are sent otherwise there")
def test_ctrl_c_ends_a_long_call_and_leaves_the_process_usable():
    environment = os.environ | {"TESTS": str(Path(__file__).parent), "OMP_NUM_THREADS": "1"}
    done = finished([sys.executable, "-c", INTERRUPTED], check=True, env=environment)
    late = [float(line) for line in done.stdout.split()]
    assert len(late) == 4
    assert max(late) < 1, late  # processor seconds: a busy machine makes nothing late


def test_other_python_threads_run_during_a_long_call():
    projection = project(20000, width=800, height=800, intrinsics=(800.0, 800.0, 400.0, 400.0))
    values = np.ones((20000, 100), np.float32)
    ticks: list[int] = []
    over = threading.Event()

    def tick() -> None:
        while not over.wait(0.001):
            ticks.append(1)

    def ticks_of_a_call() -> int:
        before = len(ticks)
        core.render_channels(projection, values, 1)
        return len(ticks) - before

    clock = threading.Thread(target=tick)
    clock.start()
    try:
        # With the interpreter's lock held, there is time for one tick before a call and for one after it.
        assert any(ticks_of_a_call() > 5 for _ in range(50))
    finally:
        over.set()
        clock.join()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_a_forked_child_renders_the_same() -> None:
    expected = image_of(project(), threads=2)
    assert forked(lambda: int(image_of(project(), threads=2) != expected)) == 0
