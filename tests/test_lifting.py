"""Where views come from when they are lifted."""

from __future__ import annotations

import torch

from scoup.lifting import load_labels
from scoup.uplifting import digest_of_labels
from support import small_scene


def test_views_read_ahead_come_in_order() -> None:
    _, cameras, regions = small_scene(count=5, views=6)
    here = list(load_labels(regions, list(cameras), torch.device("cpu")))
    ahead = list(load_labels(regions, list(cameras), torch.device("meta")))
    assert [camera.name for camera, _, _ in ahead] == [camera.name for camera in cameras]
    for (camera, labels, digest), (other, moved, same) in zip(here, ahead, strict=True):
        assert camera is other
        assert digest == same == digest_of_labels(labels)
        assert moved.is_meta
        assert moved.shape == labels.shape


def test_reading_ahead_can_be_given_up() -> None:
    _, cameras, regions = small_scene(count=5, views=6)
    views = load_labels(regions, list(cameras), torch.device("meta"))
    next(views)
    views.close()
