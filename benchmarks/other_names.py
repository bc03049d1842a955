"""Other names of the objects of scenes with real models: what people may ask for the same thing."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

OTHER_NAMES: dict[str, tuple[str, ...]] = {
    "airplane": ("aircraft", "jet plane"), "alarm clock": ("clock",), "ball": ("other balls",),
    "boot": ("boots", "footwear"), "book": ("hardback book", "paperback book"),
    "bookcase": ("shelf", "cabinet or shelf"), "bottle": ("water bottle",), "bowl": ("bowl or basin", "soup bowl"),
    "box": ("storage box", "carton"), "bust": ("sculpture", "statue", "bronze sculpture"),
    "cabinet": ("cupboard", "cabinetry", "cabinet or shelf"), "car": ("motor vehicle", "sports car"),
    "carpet": ("mat",), "cat": ("kitten",), "computer keyboard": ("keyboard",), "cushion": ("pillow",),
    "dining table": ("table", "kitchen table", "kitchen & dining room table"), "doughnut": ("donut",),
    "duck": ("duckling",), "extension cord": ("power plugs and sockets",), "fox": ("animal",),
    "kettle": ("teakettle",), "lamp": ("table lamp",), "laptop computer": ("laptop",),
    "monitor": ("computer monitor", "monitor or tv"), "mug": ("cup", "coffee cup", "teacup"),
    "orange": ("mandarin orange", "orange or tangerine", "clementine"), "penguin": ("stuffed toy",),
    "picture frame": ("picture or frame",), "plate": ("dish",), "potted plant": ("houseplant", "flowerpot"),
    "pumpkin": ("gourd", "squash"), "rose": ("flower",), "shelf": ("bookcase", "cabinet or shelf"),
    "shopping bag": ("tote bag",), "sofa": ("couch", "loveseat", "studio couch"), "sunflower": ("flower",),
    "table": ("dining table", "kitchen table", "kitchen & dining room table"), "table lamp": ("lamp",),
    "teddy bear": ("stuffed toy",), "television": ("television set", "monitor or tv"),
    "towel": ("bath towel", "hand towel"), "trash can": ("waste container", "trash bin can"),
    "vase": ("urn", "pottery"), "wardrobe": ("armoire",),
}  # fmt: skip
"""All are words of desk's table, chosen before any was asked. Most words have no other name in it."""


def names_of(labels: Iterable[str], words: Sequence[str]) -> Mapping[str, tuple[str, ...]]:
    """Return label -> its names among the words, itself first, but none that another of the labels has."""
    found = {label: (label, *OTHER_NAMES.get(label, ())) for label in labels}
    every = [name for names in found.values() for name in names]
    return {
        label: tuple(name for name in names if name == label or (name in words and every.count(name) == 1))
        for label, names in found.items()
    }
