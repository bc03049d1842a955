"""Arguments in the wrong order, or of another kind: one sentence that says which is wrong and what is expected."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest
import torch

import scoup
from messages import refuses
from scoup.io import save_regions
from scoup.models import CANONICAL_PHRASES
from support import small_scene


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> SimpleNamespace:
    folder = tmp_path_factory.mktemp("things")
    gaussians, cameras, regions = small_scene(60, views=2)
    field = scoup.build(gaussians, cameras, regions, scoup.BuildSettings(n_atoms=4, k=4))
    field.save(folder / "f.scoup")
    save_regions(regions, folder / "language_features")
    names = ["kettle", *CANONICAL_PHRASES]
    field = field.with_encoder(dict(zip(names, torch.eye(len(names), 16).numpy(), strict=True)))
    texts = field.question("kettle")
    return SimpleNamespace(
        gaussians=gaussians, cameras=cameras, regions=regions, field=field, texts=texts, path=str(folder)
    )


api: Any = scoup  # the calls below are wrong on purpose

SWAPPED: list[Callable[[Any], Any]] = [
    lambda t: api.build(t.cameras, t.gaussians, t.regions), lambda t: api.build(t.gaussians, t.regions, t.cameras),
    lambda t: api.build(t.gaussians, t.cameras, t.path), lambda t: api.build(t.gaussians, t.cameras, t.regions, 3),
    lambda t: api.region_sums(t.cameras, t.gaussians, t.regions),
    lambda t: api.region_sums(t.gaussians, t.path, t.regions),
    lambda t: api.LanguageField.load(t.path + "/f.scoup", t.path), lambda t: api.LanguageField.load(t.gaussians),
    lambda t: t.field.attach(t.path), lambda t: api.load_gaussians(t.gaussians), lambda t: api.load_cameras(None),
    lambda t: api.load_regions(t.cameras, t.path), lambda t: api.load_regions(t.path, t.path),
    lambda t: api.load_regions(t.path, t.gaussians), lambda t: api.load_regions(t.path, ["view_00.png"]),
    lambda t: api.save_gaussians("a.ply", t.gaussians), lambda t: t.field.at(t.cameras).answer("kettle"),
    lambda t: t.field.project(t.gaussians), lambda t: t.field.answer(t.cameras[0]),
    lambda t: t.field.select(t.path, t.texts), lambda t: t.field.select(t.gaussians.opacities > 0.5),
    lambda t: api.project(t.cameras[0], t.gaussians), lambda t: api.project(t.gaussians, t.cameras),
]  # fmt: skip


def test_the_argument_is_named(things: SimpleNamespace) -> None:
    for call in SWAPPED:
        with refuses(scoup.ScoupError):
            call(things)


def test_what_else_is_taken(things: SimpleNamespace) -> None:
    assert len(scoup.load_regions(things.path, (camera for camera in things.cameras))) == 2
    assert len(scoup.LanguageField.load(things.path + "/f.scoup", things.gaussians).gaussians) == 60
