"""What a notebook shows of each object."""

from __future__ import annotations

import base64
import io
import re
from typing import Any

import numpy as np
import pytest
import torch
from PIL import Image

from scoup.base import PREVIEW, card
from scoup.models import TextEncoder
from scoup.query import build
from scoup.scene.cameras import Camera, Cameras
from scoup.scene.previews import labels_preview
from scoup.scene.regions import Regions
from scoup.uplift import BuildSettings
from support import KINDS, random_gaussians, small_scene, unit

TITLES = (
    "80 Gaussians", "3 cameras", "Regions of 3 views", "Text encoder", "Language field of 80 Gaussians", "word 3",
)  # fmt: skip


def pictures(page: str) -> list[np.ndarray]:
    found = re.findall(r"data:image/png;base64,([A-Za-z0-9+/=]+)", page)
    return [np.asarray(Image.open(io.BytesIO(base64.b64decode(each)))) for each in found]


@pytest.fixture(scope="module")
def shown() -> dict[str, Any]:
    gaussians, cameras, regions = small_scene(count=80, views=3)
    field = build(gaussians, cameras, regions, BuildSettings(n_atoms=8))
    words = unit(torch.randn(30, 16, generator=torch.Generator().manual_seed(0)))
    names = ["object", "things", "stuff", "texture", *(f"word {number}" for number in range(26))]
    encoder = TextEncoder.open(dict(zip(names, words, strict=True)))
    field = field.with_encoder(encoder)
    answer = field.at(0).answer(field.question("word 3", always=True))
    return dict(zip(TITLES, (gaussians, cameras, regions, encoder, field, answer), strict=True))


@pytest.mark.parametrize("title", TITLES)
def test_every_object_has_a_card_with_a_picture_and_one_line(shown: dict[str, Any], title: str) -> None:
    page, line = shown[title]._repr_html_(), repr(shown[title])
    assert title in page
    (picture,) = pictures(page)
    assert picture.ndim == 3
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 2
    assert "\n" not in line
    assert len(line) < 200


def test_what_is_found_in_the_scene_is_shown_in_one_line(shown: dict[str, Any]) -> None:
    field = shown["Language field of 80 Gaussians"]
    place = field.location(field.question("word 3", always=True))
    for each in (place, field.label(["word 3", "word 4"]), field.location("word 3").answer):
        assert "tensor" not in repr(each)
        assert len(repr(each)) < 200
    assert repr(field.cameras[0]).startswith("Camera('view_00.png', 40 x 30, focal 36")


def test_cards_without_anything_to_draw(shown: dict[str, Any]) -> None:
    field = shown["Language field of 80 Gaussians"]
    field = type(field)(field.code_indices, field.code_weights, field.codebook, field.info)
    for each, count in (
        (field, 0),
        (Regions.from_maps({}), 0),
        (Cameras([]), 1),
        (random_gaussians(0, 0), 1),
    ):
        assert len(pictures(each._repr_html_())) == count


def test_texts_in_cards_are_no_markup() -> None:
    page = card("<b>bold</b>", {"<i>": "<script>alert(1)</script>"})
    assert "<script>" not in page
    assert "<i>" not in page
    assert "&lt;script&gt;" in page


def test_previews_of_ugly_scenes() -> None:
    for seed in range(5):
        gaussians = random_gaussians(60, seed, KINDS)
        gaussians.sh[:] = 0
        gaussians.sh[:, 0, 0] = 10.0  # red, saturated
        (picture,) = pictures(gaussians._repr_html_())
        assert picture.shape == (PREVIEW[1], PREVIEW[0], 3)
        marks = (picture != 245).any(2)
        assert (picture[marks] == (255, 128, 128)).all()
        shown = int((gaussians.finite() & (gaussians.opacities > 0.1)).sum())
        assert shown - 5 <= marks.sum() <= shown  # some hide others, or lie outside


def test_cameras_are_drawn_where_they_are() -> None:
    ring = [
        Camera.look_at((3 * np.cos(a), 3 * np.sin(a), 1.0), (0, 0, 1.0), f"{a}.png", 40, 30, 36)
        for a in np.linspace(0, 2 * np.pi, 8, endpoint=False)
    ]
    (drawn,) = pictures(Cameras(ring)._repr_html_())
    dark = np.argwhere((drawn == 30).all(2))
    middle = dark.mean(0)
    np.testing.assert_allclose(middle, (PREVIEW[1] / 2, PREVIEW[0] / 2), rtol=0, atol=6)
    distances = np.linalg.norm(dark - middle, axis=1)
    assert distances.min() > 0.7 * distances.max()  # a ring


def test_regions_have_colours_of_their_own() -> None:
    labels = torch.tensor([[0, 1], [2, -1]], dtype=torch.int32).kron(torch.ones(4, 4, dtype=torch.int32))
    drawn = labels_preview(labels)
    assert drawn.shape == (8, 8, 3)
    assert len(np.unique(drawn.reshape(-1, 3), axis=0)) == 4
    assert not drawn[-1, -1].any()
