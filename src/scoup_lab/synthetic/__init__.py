"""Everything simulated: scenes, their observations and words, data sets, random scenes.

``make_demo_scene`` makes a scene whose truth is known; nothing is downloaded. ``art/`` contains what its pictures show.
"""

from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.table import TABLE
from scoup_lab.synthetic.folder import write_demo_scene
from scoup_lab.synthetic.scene import EMBEDDING_MODEL, DemoScene, make_demo_scene

__all__ = ["EMBEDDING_MODEL", "TABLE", "DemoScene", "Layout", "make_demo_scene", "write_demo_scene"]
