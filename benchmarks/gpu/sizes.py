"""How large everything is."""

from __future__ import annotations

from dataclasses import dataclass

from scoup.synthetic.random_scene import HEIGHT, REGIONS, WIDTH


@dataclass(frozen=True)
class Sizes:
    """Sizes of what is measured; the defaults are those of a LERF scene.

    Attributes:
        n_gaussians: N of the one scene that most stages look at.
        width, height: of its view, in pixels.
        large: width and height of the other view.
        n_atoms: L of the codebooks that are compared; the first is the paper's.
        k: K.
        dim: D.
        regions: in the view, at levels s, m, l.
        channels: what the peer renders besides RGB; the last is D.
        build_views: views of the build.
        build_regions: regions in each of them, at each level.
        epochs: of the paper's solver.
        epochs_run: how many of them are run; the time of the others is extrapolated, and the row says so.
        counts: N of the scenes in which the growth with N is measured.
        zooms: sizes of the view relative to ``width`` x ``height``, for the growth with the number of pixels.
        levels: numbers of levels, for the growth with these.
        repeats: interleaved repetitions; medians count.
        warm_up: run everything a few times before it is timed.
        check_gaussians, check_size: N, width and height of what is compared with the reference first.
        ceiling_bytes, ceiling_edge, ceiling_rounds: of the array copied, the matrices multiplied, and the multiply-adds
            in a row of each number.
    """

    n_gaussians: int = 1_000_000
    width: int = WIDTH
    height: int = HEIGHT
    large: tuple[int, int] = (1920, 1080)
    n_atoms: tuple[int, ...] = (64, 128)
    k: int = 4
    dim: int = 512
    regions: tuple[int, ...] = REGIONS
    channels: tuple[int, ...] = (64, 192, 512)
    build_views: int = 200
    build_regions: tuple[int, ...] = (100, 100, 100)
    epochs: int = 4000
    epochs_run: int = 4000
    counts: tuple[int, ...] = (300_000, 1_000_000, 3_000_000, 10_000_000)
    zooms: tuple[float, ...] = (0.5, 1.0, 2.0)
    levels: tuple[int, ...] = (1, 2, 3, 6)
    repeats: int = 15
    warm_up: bool = True
    check_gaussians: int = 3000
    check_size: tuple[int, int] = (150, 110)
    ceiling_bytes: int = 1 << 30
    ceiling_edge: int = 8192
    ceiling_rounds: int = 4096


FULL = Sizes()
QUICK = Sizes(
    epochs_run=200,
    counts=(300_000, 1_000_000, 3_000_000),
    repeats=5,
    ceiling_bytes=1 << 28,
    ceiling_edge=4096,
    ceiling_rounds=1024,
)
SMOKE = Sizes(
    n_gaussians=20,
    width=15,
    height=11,
    large=(16, 13),
    n_atoms=(16,),
    k=2,
    dim=16,
    regions=(3, 2, 1),
    channels=(4, 16),
    build_views=1,
    build_regions=(2, 2, 2),
    epochs=6,
    epochs_run=3,
    counts=(8, 20),
    zooms=(0.5, 1.0),
    levels=(1, 2),
    repeats=1,
    warm_up=False,
    check_gaussians=20,
    check_size=(15, 11),
    ceiling_bytes=1 << 12,
    ceiling_edge=32,
    ceiling_rounds=16,
)
"""Tiny: proves that every stage runs with interpreted kernels, and nothing else."""
