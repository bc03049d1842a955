"""Everything simulated: scenes made by a program, their observations and words, faults, data sets, random scenes.

``make_demo_scene`` makes a scene whose truth is known; nothing is downloaded. ``art/`` contains what is drawn in it.
"""

from scoup_lab.synthetic.art.layout import Layout
from scoup_lab.synthetic.art.table import TABLE
from scoup_lab.synthetic.folder import write_demo_scene
from scoup_lab.synthetic.scene import EMBEDDING_MODEL, DemoScene, make_demo_scene

__all__ = ["EMBEDDING_MODEL", "TABLE", "DemoScene", "Layout", "make_demo_scene", "write_demo_scene"]
