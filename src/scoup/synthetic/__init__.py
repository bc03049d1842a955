"""A scene that needs no download: made by a program, with the truth known. See ``scene.make_demo_scene``."""

from scoup.synthetic.folder import write_demo_scene
from scoup.synthetic.scene import EMBEDDING_MODEL, DemoScene, make_demo_scene

__all__ = ["EMBEDDING_MODEL", "DemoScene", "make_demo_scene", "write_demo_scene"]
