"""Masks and embeddings of your own, as numpy arrays: here tiles of the photographs, described by their colours.

    python examples/04_own_embeddings.py demo/scene red

Replace ``tiles`` and ``describe`` by your segmenter and your image model: any masks, any vectors of one length.
Texts need vectors of the same kind; here a few colours serve as words.
"""

import sys

import numpy as np

import scoup

COLORS = {
    "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1), "white": (1, 1, 1), "black": (0, 0, 0),
    "object": (0.5, 0.5, 0.5), "things": (0.6, 0.5, 0.4), "stuff": (0.4, 0.5, 0.6), "texture": (0.5, 0.6, 0.5),
}  # fmt: skip
LEVELS = {"s": 12, "m": 6, "l": 3}  # tiles along each side, fine to coarse


def tiles(height: int, width: int, count: int) -> np.ndarray:
    """[H, W] the number of each pixel's tile; -1 would be no region."""
    rows, columns = (np.arange(side) * count // side for side in (height, width))
    return (rows[:, None] * count + columns).astype(np.int32)


def describe(rgb: np.ndarray) -> np.ndarray:
    """[.., 8] of colours [.., 3] in 0..1: how near each is to the corners of the cube of colours."""
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * 3), -1).reshape(8, 3)
    return np.exp(-3 * np.square(rgb[..., None, :] - corners).sum(-1))


if len(sys.argv) < 3:
    sys.exit(__doc__)
scene, word = sys.argv[1:3]
gaussians = scoup.load_gaussians(scene)
cameras = scoup.load_cameras(scene)
maps = {}
for camera in cameras:
    pixels = scoup.load_image(camera).numpy() / 255
    maps[camera.name] = {}
    for level, count in LEVELS.items():
        labels = tiles(camera.height, camera.width, count)
        means = np.stack([pixels[labels == number].mean(0) for number in range(count**2)])
        maps[camera.name][level] = scoup.RegionMap(labels, describe(means))  # pyright: ignore[reportArgumentType]

settings = scoup.BuildSettings(check_fit=False)
words = {name: describe(np.array(color, float)) for name, color in COLORS.items()}
field = scoup.build(gaussians, cameras, scoup.Regions.from_maps(maps), settings).with_encoder(words)
answer = field.at(cameras[0]).answer(word)
print(
    f"{word} in {answer.view}: pixel {answer.point}, {answer.coverage:.0%} of the view, level {answer.level}"
)
