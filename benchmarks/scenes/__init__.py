"""The four layouts that studies run on: the demo's table, and shelves, hall and yard, whose things are kept here."""

from __future__ import annotations

from benchmarks.scenes.hall import HALL
from benchmarks.scenes.shelves import SHELVES
from benchmarks.scenes.yard import YARD
from scoup import LanguageField, build
from scoup.base import looked_up
from scoup_lab.synthetic import TABLE, Layout
from scoup_lab.synthetic.scene import DemoScene, make_demo_scene

LAYOUTS: dict[str, Layout] = {layout.name: layout for layout in (TABLE, SHELVES, HALL, YARD)}


def find_layout(name: str) -> Layout:
    """Return the layout of that name."""
    return looked_up("layout", name, LAYOUTS)


def field_of(scene: DemoScene) -> LanguageField:
    """Return the field of a scene, which its own words encode the texts for."""
    built = build(scene.gaussians, scene.building, scene.regions)
    texts = scene.words.texts
    return built.with_encoder(dict(zip(texts, scene.text_vectors(texts), strict=True)))


def scene_of(name: str, *size: int) -> DemoScene:
    """Return the scene of a layout and a seed, such as "shelves-0"; ``size``: as for ``make_demo_scene``."""
    layout, _, seed = name.rpartition("-")
    found = find_layout(layout)
    return make_demo_scene(int(seed), *size, layout=found)
