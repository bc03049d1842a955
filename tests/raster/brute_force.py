"""An independent evaluation of the blending weights, per pixel in float64, straight from the formulas.

Written without the package's rasteriser: conics by matrix inversion, no tiles, no sorting tricks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CONSTANTS = {"inria": (0.2, 0.99), "gsplat": (0.01, 0.99)}


@dataclass(frozen=True)
class Truth:
    """weights [N, H, W] float64; unsure [H, W]: pixels where a threshold is too close to call in float32."""

    weights: np.ndarray
    unsure: np.ndarray


def blending_weights(gaussians, camera, preset: str, margin: float = 2e-3) -> Truth:
    near, alpha_max = CONSTANTS[preset]
    means, quats, scales = (
        getattr(gaussians, n).numpy().astype(np.float64) for n in ("means", "quats", "scales")
    )
    opacities = gaussians.opacities.numpy().astype(np.float64)
    viewmat, K = camera.viewmat.numpy(), camera.K.numpy()
    height, width = camera.height, camera.width
    ys, xs = np.mgrid[:height, :width] + 0.5
    weights = np.zeros((len(means), height, width))
    unsure = np.zeros((height, width), bool)

    drawable = []
    for i in range(len(means)):
        numbers = np.concatenate([means[i], quats[i], scales[i]])
        if not np.isfinite(numbers).all() or np.isnan(opacities[i]) or not quats[i].any():
            continue
        depth = (viewmat[:3, :3] @ means[i] + viewmat[:3, 3])[2]
        if depth > near:
            drawable.append((depth, i))
    transmittance = np.ones((height, width))
    stopped = np.zeros((height, width), bool)
    for _, i in sorted(drawable):
        centre, covariance = _project(means[i], quats[i], scales[i], viewmat, K, width, height, preset)
        conic = np.linalg.inv(covariance)
        dx, dy = xs - centre[0], ys - centre[1]
        q = conic[0, 0] * dx * dx + (conic[0, 1] + conic[1, 0]) * dx * dy + conic[1, 1] * dy * dy
        alpha = np.minimum(alpha_max, min(opacities[i], 1.0) * np.exp(-0.5 * q))
        unsure |= ~stopped & (np.abs(alpha * 255 - 1) < margin)
        alpha[alpha < 1 / 255] = 0
        after = transmittance * (1 - alpha)
        unsure |= ~stopped & (alpha > 0) & (np.abs(after / 1e-4 - 1) < margin)
        stopped |= after < 1e-4
        weights[i] = np.where(stopped, 0, alpha * transmittance)
        transmittance = np.where(stopped, transmittance, after)
    return Truth(weights, unsure)


def _project(mean, quat, scale, viewmat, K, width, height, preset):
    w, x, y, z = quat / np.linalg.norm(quat)
    rotation = np.array(
        [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
    )
    covariance = rotation @ np.diag(scale**2) @ rotation.T
    tx, ty, tz = viewmat[:3, :3] @ mean + viewmat[:3, 3]
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    half_x, half_y = width / (2 * fx), height / (2 * fy)
    if preset == "inria":
        bounds = (-1.3 * half_x, 1.3 * half_x, -1.3 * half_y, 1.3 * half_y)
    else:
        bounds = (
            -(cx / fx + 0.3 * half_x),
            (width - cx) / fx + 0.3 * half_x,
            -(cy / fy + 0.3 * half_y),
            (height - cy) / fy + 0.3 * half_y,
        )
    sx = tz * min(bounds[1], max(bounds[0], tx / tz))
    sy = tz * min(bounds[3], max(bounds[2], ty / tz))
    jacobian = np.array([[fx / tz, 0, -fx * sx / tz**2], [0, fy / tz, -fy * sy / tz**2]])
    turned = jacobian @ viewmat[:3, :3]
    return (fx * tx / tz + cx, fy * ty / tz + cy), turned @ covariance @ turned.T + 0.3 * np.eye(2)
