"""Sanity checks of Gaussians: damaged numbers that are finite, and so pass every other check."""

from __future__ import annotations

import numpy as np

from scoup.base import share_of
from scoup.scene.gaussians import Gaussians

LARGE = 100.0  # times the extent of the scene: more than the sky of any outdoor scene
FAR = 10_000.0
FAINT = 1 / 255  # the least alpha that a rasteriser draws
_SAMPLE = 100_000  # Gaussians that tell the extent
_REMEDY = "export or train the splat again, or remove them (in the SuperSplat editor)"


def sanity_problems(gaussians: Gaussians) -> list[str]:
    """Return implausible properties of Gaussians, one sentence each, with counts and remedies; empty for a sound scene.

    The extent is that of the middle 90 % along each axis, so that stray Gaussians do not enlarge it.
    """
    if not len(gaussians):
        return []
    means = gaussians.means.detach().cpu().double().numpy()
    scales = gaussians.scales.detach().amax(1).cpu().double().numpy()
    step = max(1, len(means) // _SAMPLE)
    lowest, middle, highest = np.nanquantile(means[::step], (0.05, 0.5, 0.95), axis=0)
    extent = float(np.linalg.norm(highest - lowest))
    total = len(gaussians)
    problems = []
    if extent > 0:
        large = int((scales > LARGE * extent).sum())
        far = int((np.abs(means - middle).max(1) > FAR * extent).sum())
        if large:
            some = f"{share_of(large, total, 'Gaussian')} {'is' if large == 1 else 'are'}"
            problems.append(f"{some} over {LARGE:.0f} times larger than the scene; {_REMEDY}")
        if far:
            some = f"{share_of(far, total, 'Gaussian')} {'is' if far == 1 else 'are'}"
            problems.append(f"{some} over {FAR:,.0f} times the scene's size away from it; {_REMEDY}")
    if float(gaussians.opacities.nan_to_num(0).max()) < FAINT:
        every = "the only Gaussian is" if total == 1 else f"all {total:,} Gaussians are"
        problems.append(
            f"{every} transparent (no opacity reaches 1/255), so nothing is visible; export the splat again, with "
            "opacities as training left them (in a PLY as logits)"
        )
    if gaussians.antialiased:
        problems.append(
            "the splat was trained with antialiasing, which lowers opacities by size in pixels; SCOUP rasterises "
            "without it, so small and distant Gaussians weigh too much; best train without it"
        )
    return problems
