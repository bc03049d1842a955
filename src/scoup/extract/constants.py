"""The constants of this room that decide which views are taken, and so answers: value, unit, and where each comes from.

Modules read them as ``constants.NAME`` when they need them. Settings of masks are ``MaskSettings``: the papers', and
``fast``, tuned on desk (docs/extract.md). The studies of answers begin with regions, so none of these can be left out
there. Unless said otherwise they were tuned on table-20, hall-20 and desk (docs/answers.md, chosen photographs).
"""

import math

# Photographs that are extracted.
FEW = 24
"""Photographs that are always taken."""
LEAST_PHOTOGRAPH_GAIN = 0.006
"""Share of what the best photograph gains alone; photographs that gain less are not taken."""
PHOTOGRAPH_NEIGHBOURS = 8
"""Photographs that show the most of the same, with which the sharpness of one is compared."""
SECTORS = 60
"""Directions from which a Gaussian is seen."""
SHARP = 0.75
"""Quantile of their sharpness from which a photograph is as sharp as it can be."""

# Masks of the preset fast.
MANY = 8
"""Large masks over a point of the last grid, from which it is taken as known. Tuned on desk."""

# Candidates for own views. Their numbers are limits on time; angles and distances were chosen, not tuned.
MATTER_OPACITY = 0.3
"""Opacity from which a Gaussian counts as matter."""
LEAST_MATTER = 0.25
"""Share of the Gaussians that are matter, however transparent the splat is."""
ANGLE_OF_VIEW = math.radians(65)
"""Radians across the image."""
ELEVATIONS = (8.0, 25.0, 50.0, 75.0)
"""Degrees, of the circles around the scene."""
AZIMUTHS = 12
"""Cameras on a circle."""
DISTANCES = (0.4, 0.65, 1.0)
"""Shares of the distance from which the whole scene fills the image."""
PLACES = 20
"""Places in free space."""
HEADINGS = 8
"""Directions in which a place looks."""
PITCHES = (-5.0, -25.0)
"""Degrees, of the cameras at a place."""
MOVE = 0.15
"""Share of the radius of the scene by which a camera is moved along each axis to see whether it sees more."""
TURN = 15.0
"""Degrees by which it is turned then."""
LOWEST, HIGHEST = math.radians(-70), math.radians(30)
"""Radians, of its pitch."""
PARTS = 16
"""Parts of the matter, each with a half circle of cameras of its own."""
AROUND_PART = 10
"""Cameras of such a half circle."""
CELLS = 48
"""Cells along the longest side of the grid of free space."""

# The choice of own views.
ROUNDS = 2
"""Rounds in which the best cameras are moved a little."""
PARENTS = 24
"""Cameras that are moved."""
CHILDREN = 4
"""Cameras that each of them becomes."""
LEAST_VIEW_GAIN = 0.02
"""Share of what the best view gains alone; views that gain less are not taken."""
MOST_VIEWS = 64
"""Views that are taken unless a number is asked for."""
COVERING_OPACITY = 0.5
"""Opacity from which a Gaussian counts for the coverage."""
NEAR = 0.12
"""Share of the radius of the scene: what is nearer is too near."""
NEAR_PLANE = NEAR / 2
"""Share of the radius of the scene: what is nearer is not drawn."""
BLURRED = 0.06
"""Share of the width of the image: standard deviation of a Gaussian that is too large to be sharp."""
CLOSE = 2.0
"""Times the size at which all matter fills an image: Gaussians as large are near enough."""
SMALLEST = 0.25
"""Quantile of sizes: smaller Gaussians need not be nearer than these."""
FULL = 16
"""Power of the share of an image that is not empty, by that of the fullest view of a Gaussian."""
LEAST_FULL = 0.2
"""Such a share: views that are emptier are never good."""
STRICT = 8
"""Power of the share that is opaque, by that of the best view."""
TURNED = 0.2
"""Logarithm of elongation: what counts as facing."""
SPAN = 0.2
"""Logarithm of elongation over which the rest loses."""
MOST_ELONGATED = 4.0
"""Elongation that counts at most."""
NO_QUALITY = 1e-6
"""Quality of a view that shows nothing well: it is chosen where there is no other."""
DIRECTIONS = 10.0
"""Directions from which each Gaussian is to be seen, at most."""
