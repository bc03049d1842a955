"""Other forms of tensors that the compiled core is handed, and labels that it must refuse."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from messages import refuses
from raster.parity import assert_close, assert_same_sums, needs_native
from scoup import raster
from scoup.scene import Gaussians
from support import make_camera, random_gaussians, random_labels, unit

pytestmark = needs_native
COUNT, LEVELS, ATOMS, REGIONS = 50, 3, 8, 5
CAMERA = make_camera()


def a_view() -> raster.Projection:
    return raster.project(random_gaussians(COUNT, 1), CAMERA, backend="native")


def inputs() -> dict:
    generator = torch.Generator().manual_seed(0)
    return {
        "values": torch.rand(COUNT, 3, generator=generator),
        "labels": random_labels(LEVELS, CAMERA.height, CAMERA.width, REGIONS, 0),
        "indices": torch.randint(ATOMS, (COUNT, LEVELS, 4), generator=generator, dtype=torch.uint8),
        "weights": torch.rand(COUNT, LEVELS, 4, generator=generator),
        "codebook": torch.rand(LEVELS, ATOMS, 6, generator=generator),
        "queries": unit(torch.rand(2, 6, generator=generator)),
    }


def apart(tensor: torch.Tensor) -> torch.Tensor:
    """The same values with gaps between them in memory."""
    found = torch.stack([tensor, tensor], -1)[..., 0]
    assert not found.is_contiguous()
    return found


FORMS = {
    "apart": apart,
    "float64": lambda tensor: tensor.double() if tensor.is_floating_point() else tensor.long(),
    "requires_grad": lambda tensor: (
        tensor.clone().requires_grad_() if tensor.is_floating_point() else tensor.int()
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_other_forms_of_the_same_numbers(form):
    change, projection, given = FORMS[form], a_view(), inputs()
    changed = {name: change(tensor) for name, tensor in given.items()}
    assert torch.equal(
        raster.render_channels(projection, changed["values"])[0],
        raster.render_channels(projection, given["values"])[0],
    )
    assert_same_sums(
        raster.region_sums(projection, changed["labels"]), raster.region_sums(projection, given["labels"])
    )
    codes = [(given["indices"], given["weights"]), (changed["indices"], changed["weights"])]
    maps = [raster.render_codes(projection, *pair, ATOMS) for pair in codes]
    assert torch.equal(*maps)
    cosines = [
        raster.render_cosines(projection, *pair, side["codebook"], side["queries"])
        for pair, side in zip(codes, (given, changed), strict=True)
    ]
    assert_close(cosines[1], cosines[0])
    assert not cosines[1].requires_grad


@pytest.mark.parametrize("form", ["apart", "requires_grad"])
def test_other_forms_of_the_scene(form):
    plain = random_gaussians(COUNT, 1)
    changed = Gaussians(
        *(FORMS[form](getattr(plain, name)) for name in ("means", "quats", "scales", "opacities", "sh"))
    )
    values = inputs()["values"]
    found = raster.render_channels(raster.project(changed, CAMERA, backend="native"), values)
    expected = raster.render_channels(a_view(), values)
    assert torch.equal(found[0], expected[0])


def test_labels_below_zero_are_no_region_and_those_beyond_32_bits_are_refused():
    labels, projection = inputs()["labels"].long(), a_view()
    found = raster.region_sums(projection, torch.where(labels >= 0, labels, -(2**32)))
    assert_same_sums(found, raster.region_sums(projection, labels))
    for offset in (2**31, 2**32, 2**40):
        with refuses():
            raster.region_sums(projection, torch.where(labels >= 0, labels + offset, -1))


def test_scales_count_by_their_size():
    """A covariance holds squares of scales, so their sign means nothing."""
    plain, values = random_gaussians(COUNT, 1), inputs()["values"]
    mirrored = raster.project(replace(plain, scales=-plain.scales), CAMERA, backend="native")
    found, expected = (raster.render_channels(view, values)[0] for view in (mirrored, a_view()))
    assert torch.equal(found, expected)
