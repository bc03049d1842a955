"""Arguments in the wrong order, or of another kind: one sentence that says which is wrong and what is expected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

import scoup
from scoup.io import save_regions
from scoup.models import CANONICAL_PHRASES, save_table
from scoup.scene import Cameras, Gaussians, Regions
from support import small_scene, unit


@dataclass(frozen=True)
class ThingTable:
    """One of everything."""

    gaussians: Gaussians
    cameras: Cameras
    regions: Regions
    field: scoup.LanguageField
    encoder: scoup.TextEncoder
    texts: Any
    path: str


@pytest.fixture(scope="module")
def things(tmp_path_factory: pytest.TempPathFactory) -> ThingTable:
    import torch

    folder = tmp_path_factory.mktemp("things")
    gaussians, cameras, regions = small_scene(60, views=2)
    field = scoup.build(gaussians, cameras, regions, scoup.BuildSettings(n_atoms=4, k=4))
    field.save(folder / "f.scoup")
    save_regions(regions, folder / "language_features")
    names = ["kettle", *CANONICAL_PHRASES]
    save_table(folder / "words.npz", names, unit(torch.eye(len(names), 16)).numpy())
    encoder = scoup.TextEncoder.open(folder / "words.npz")
    field = field.with_encoder(encoder)
    texts = field.question("kettle")
    return ThingTable(gaussians, cameras, regions, field, encoder, texts, str(folder))


api: Any = scoup  # the calls below are wrong on purpose

SWAPPED: list[tuple[Callable[[Any], Any], str]] = [
    (lambda t: api.build(t.cameras, t.gaussians, t.regions), "build: the argument gaussians is of type Cameras, "
     "expected Gaussians (the order is gaussians, cameras, regions); get one from scoup.load_gaussians(path)"),
    (lambda t: api.build(t.gaussians, t.regions, t.cameras), "build: the argument cameras is of type Regions"),
    (lambda t: api.build(t.gaussians, t.cameras, t.path), "build: the argument regions is of type str"),
    (lambda t: api.build(t.gaussians, t.cameras, t.regions, 3), "the argument settings is of type int"),
    (lambda t: api.region_sums(t.cameras, t.gaussians, t.regions), "region_sums: the argument gaussians is of"),
    (lambda t: api.region_sums(t.gaussians, t.path, t.regions), "region_sums: the argument cameras is of type str"),
    (lambda t: api.LanguageField.load(t.path + "/f.scoup", t.path), "LanguageField.load: the argument gaussians is "
     "of type str, expected Gaussians (the order is path, gaussians); get one from scoup.load_gaussians(path)"),
    (lambda t: api.LanguageField.load(t.gaussians), "LanguageField.load: the argument path is of type Gaussians"),
    (lambda t: t.field.attach(t.path), "LanguageField.attach: the argument gaussians is of type str"),
    (lambda t: api.load_gaussians(t.gaussians), "load_gaussians: the argument path is of type Gaussians, expected a"),
    (lambda t: api.load_cameras(None), "load_cameras: the argument path is of type NoneType, expected a path"),
    (lambda t: api.load_regions(t.cameras, t.path), "load_regions: the argument folder is of type Cameras"),
    (lambda t: api.load_regions(t.path, t.path), "load_regions: the argument cameras is of type str"),
    (lambda t: api.load_regions(t.path, t.gaussians), "load_regions: the argument cameras is of type Gaussians"),
    (lambda t: api.load_regions(t.path, ["view_00.png"]), "load_regions: the argument cameras is of type list"),
    (lambda t: api.save_gaussians("a.ply", t.gaussians), "save_gaussians: the argument gaussians is of type str"),
    (lambda t: t.field.at(t.cameras).answer("kettle"), "the argument camera is of type Cameras"),
    (lambda t: t.field.project(t.gaussians), "LanguageField.camera: the argument camera is of type Gaussians"),
    (lambda t: t.field.answer(t.cameras[0]), "expected a text, a list of texts, or vectors"),
    (lambda t: t.field.select(t.path, t.texts), "select: the argument reshaping is of type Question"),
    (lambda t: t.field.select(t.gaussians.opacities > 0.5), "got Tensor; a part of a field is field[mask]"),
    (lambda t: api.project(t.cameras[0], t.gaussians), "project: the argument gaussians is of type Camera"),
    (lambda t: api.project(t.gaussians, t.cameras), "project: the argument camera is of type Cameras"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "said"), SWAPPED, ids=[said[:50] for _, said in SWAPPED])
def test_the_argument_is_named(things: ThingTable, call: Callable[[Any], Any], said: str) -> None:
    with pytest.raises(scoup.ScoupError) as refusal:
        call(things)
    assert said in str(refusal.value)


def test_what_else_is_taken(things: ThingTable) -> None:
    assert len(scoup.load_regions(things.path, (camera for camera in things.cameras))) == 2
    assert len(scoup.LanguageField.load(things.path + "/f.scoup", things.gaussians).gaussians) == 60
