"""Names of the classes that labelled points have, in the order of their numbers; read from OpenGaussian's
``scripts/eval_scannet.py``."""

from __future__ import annotations


def _listed(text: str) -> tuple[str, ...]:
    """Return names between commas, over any number of lines."""
    return tuple(" ".join(name.split()) for name in text.split(","))


NYU40 = _listed("""
    unlabeled, wall, floor, cabinet, bed, chair, sofa, table, door, window, bookshelf, picture, counter, blinds,
    desk, shelves, curtain, dresser, pillow, mirror, floormat, clothes, ceiling, books, refrigerator,
    television, paper, towel, showercurtain, box, whiteboard, person, nightstand, toilet, sink, lamp, bathtub,
    bag, otherstructure, otherfurniture, otherprop
""")
"""The 40 classes of NYU and what has none, as that script spells them; numbers of ScanNet's labels."""
