"""The constants of this room that decide answers: value, unit, and where each comes from.

Modules read them as ``constants.NAME`` when they need them, so that the study of answers can leave one out. Those
of the check of splat and cameras are in ``fit`` and ``similarity``: they decide no answer.
Unless said otherwise, they were tuned on other renders of table, shelves, hall and yard, and on desk (docs/answers.md).
"""

# Region sums.
AUTO_SIDE = 500
"""Pixels of the longer side of the images that region sums are made of (docs/answers.md, the size of the images)."""

# The rounds of the vote after the first.
SHARPNESS = 3.0
"""Times the inverse of the median deviation: a region with the median deviation counts exp(-3)."""
LEAST_FACTOR = 1e-6
"""Least factor of a region, so that no Gaussian loses its code. Not tuned. The compiled core and the Triton kernel have
it built in."""
LEAST_DEVIATION = 1e-3
"""1 - cosine; identical regions would make the sharpness infinite. Not tuned."""
SAMPLED_VIEWS = 8
"""Views in which deviations are measured; a limit on time."""

# Regions that become things.
LEAST_SHARE = 0.05
"""Share of a Gaussian's largest entry; entries below it do not decide what is merged."""
MASS = 0.98
"""Share of all contributions; the Gaussians that contribute it, largest first, decide what is merged."""
MOST_VIEWS = 48
"""Views that decide, of more evenly spread by name: merging takes time with their square."""
MOST_DECIDING = 300_000
"""Gaussians that decide, of more every second, third, ...; all have owners. A limit on time."""
LEAST_IOU = 0.3
"""IoU of clusters of regions; those that overlap less are different things."""
LEAST_REGIONS = 2
"""Regions of a thing: one that no other view confirms is not a thing."""
INSIDE = 0.5
"""Share of a thing's Gaussians that its parent must own, too. Not tuned: from one half on there is one such parent."""

# Strays of things. Tuned on table-20, hall-20 and desk (docs/method.md).
PER_SIZE = 24
"""Cells along a thing, if it has enough Gaussians to fill them."""
SPACING = 3.0
"""Least edge of a cell, in sizes of the thing divided by the root of its number of Gaussians."""
KEPT = 0.25
"""Share of the weight of the heaviest part; connected parts with this share stay: a thing seen in pieces."""
NEIGHBOURS = 8
"""Nearest cells to which a cell is linked."""
TOUCHING = 1.8
"""Distance of linked cells, in cells: those that share a corner (1.73). Not tuned."""

# Names of things by a model that takes words. They count only for regions with concepts.
NAMING_SIDE = 320
"""Pixels of the longer side of the pictures in which things and detections are compared."""
NAMING_PIXELS = 12
"""Pixels of a thing in such a picture; smaller ones are not seen."""
NAMING_IOU = 0.55
"""IoU below which thing and detection are different."""
BEST_VIEWS = 10
"""Views that count for the vote of a text for a thing."""
BEST_SCORES = 5
"""Views that count for the presence of a text."""
EVEN_SCORE = 0.05
"""The mean score at which a text is as likely present as not. So, with the field's odds (``scoup.query.named``), one in
twenty present texts has less than 0.37, the least of what was present when this was tuned."""

# Codes on another splat.
NEAREST = 4
"""Gaussians of the field that are tried for each Gaussian of the splat. Not tuned."""
