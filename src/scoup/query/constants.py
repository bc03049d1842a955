"""The constants of this room that decide answers: value, unit, and where each comes from.

Modules read them as ``constants.NAME`` when they need them, so that the study of answers can leave one out. Unless said
otherwise, they were tuned on other renders of table, shelves, hall and yard, and on desk (docs/answers.md).
"""

# Fits of things to texts.
HUB_QUANTILE = 0.99
"""The words that fit a thing best are those above this quantile."""
HUB_SHARE = 0.5
"""Share of the cosine with the words that fit a thing best that is subtracted from its cosines. Without it -.087 over
the thirteen settings with real models (constants.json, as all figures of this kind)."""
FEW_REGIONS = 2.0
"""Spreads over the root of the number of regions, by which a fit is lowered, as the error of a mean falls.
Without it -.015."""
UNSTABLE = 0.25
"""Spreads times the logarithm of 1 / stability, by which the fit of a thing is lowered. Without it -.005."""
LEAST_STABILITY = 0.02
"""Stability below which a thing counts as having this one. Not tuned."""

# The choice of the things that answer.
MOST_GAP = 3.0
"""Spreads that the gap behind a set counts at most. Without it -.124."""
MOST_TOGETHER = 8
"""Things that may answer together. With one -.038."""
SAME_GAUSSIANS = 0.5
"""Two sets have the same Gaussians from this intersection over union. A thing with at least this share of its Gaussians
in a set, or that share of the set in it, is no rival. With 1 -.034."""
MOST_COVERED = 0.5
"""Share of the Gaussians of its level that a set may have, unless one of its things fits best or nothing else may
answer. Without it -.003, on fox -.04; with the AGREEMENT of
.25 before it, fox and fox-17 -.07 and -.06. The same with .6; .4 drops a cloth that fills a scene."""
RIVAL = 2.0
"""Weight of the lead of things elsewhere over the mean fit of a set. Without it -.005, at worst -.05."""
AGREEMENT = 0.5
"""Weight of the score of a set of another level with the same Gaussians. For .25 +.005. Without it -.014, at
worst -.13, but on desk and fox +.02."""

# Presence.
PRESENT_FROM = 0.35
"""The default score from which a text counts as present."""
NEARER_SHARES, MOST_SCORES = (0.0, 0.02, 0.05, 0.07, 1.0), (1.0, 0.8, 0.6, 0.35, 0.2)
"""The most that a text scores if such shares of the other words are nearer to the thing that fits it best than it is:
about the pairs that refuse most for what they keep. Mean of 13 settings: .92 kept, .78 refused (.93,
.67 without, from .37)."""
LIKELY, SURE = 0.6, 0.9
"""Scores from which people read "likely" and "sure"."""
OTHER_NAME = 3.0
"""Standard deviations of words above their mean from which a word is another name of a query."""
SAME_WORD = 0.99
"""Cosine from which a word is the query itself. Not tuned."""

# Names that a model with words gave. Tuned on eight other settings (docs/answers.md#with-a-model-that-takes-words).
AGREES = 0.85
"""Model and field agree if a thing of the field's answer has at least this share of the largest vote."""
TOGETHER = 0.45
"""Things with at least this share of the largest vote answer together."""
FIELD_POWER = 1 / 3
"""Power of the field's odds of presence; they are 1 to 99 at least and 99 to 1 at most."""
NEAR_NAME = 0.95
"""Cosine with a name of a thing from which a text counts as the same. Not tuned."""
MOST_PHOTOGRAPHS = 12
"""Photographs in which a text is looked for on demand."""
ALL_THINGS = 0.2
"""Weight of all things together in the choice of photographs, beside the one that fits a text best."""
LARGE = 0.05
"""Share of a picture's longest side; a thing of this radius is seen as well as any larger one."""

# Names of things, and the choice of objects (docs/things.md).
NAMES = 3
"""Names kept per thing: the best and the next best ones."""
COMMON_THINGS, COMMON_SHARE = 10, 0.5
"""Some words are near to many things: this share of the mean of a word's so many largest cosines is subtracted from all
of them (cross-domain similarity local scaling, Conneau et al. 2018)."""
SHORT_LIST = 200
"""Words of a list up to which the nearest itself is the name. Figures in docs/things.md; chosen on the same scenes."""
NEAREST_WORDS, IN_COMMON = 8, 5
"""Nearest words of a thing, and how many of them have to be below the broader word that names it. As SHORT_LIST."""
UNNAMED = 0.6
"""How well no word fits a thing, beside the scores of nearest words."""
LEAST_REGIONS = 5
"""Regions; unnamed things of fewer are fragments, not objects."""
STABLE = 0.6
"""Stability; unnamed things that are less stable and that no other level found are fragments."""

# Runner-ups (docs/answers.md).
RUNNER_UP = 1.25
"""Spreads by which the best thing elsewhere may fit worse than the answer, to be named beside it. Chosen on table and
shelves."""

# Votes of Gaussians, where no things answer (docs/answers.md).
LOWEST, HIGHEST = 0.44, 0.84
"""Thresholds considered, on the rescaled relevancy, as the papers' thresholds are."""
WINDOW = 0.1
"""Thresholds over which the change of area is taken."""
CENTRE, PULL = 0.64, 0.05
"""Of thresholds that are almost as stable, the one nearer to the centre is taken: its distance times the pull is added
to the change."""
MOST_SAMPLED = 8192
"""Gaussians that stand for all where texts are compared with everyday words. A limit on time."""
STRAY_SHARE = 0.1
"""Share of the weight of the largest connected part; lighter parts are strays."""

# Answers in views.
PIXEL_SHARE = 0.5
"""Share of a pixel from which it belongs to the Gaussians that contribute it. Not tuned: the larger half."""
SPECK = 0.02
"""Share of the area of the largest part of a mask; smaller parts are specks."""
AVERAGED = 7
"""Pixels, side of the box over which relevancy is averaged to find the most relevant pixel (the paper's)."""

# Boxes of things.
BOX_WEIGHT = 0.98
"""Share of the weight inside a box along each of its axes."""
FARTHEST = 4.0
"""Times its median distance from the middle of a thing from which a Gaussian is a stray."""
TURNS, SAMPLED, CLEARLY = 9, 200, 0.9
"""Of so many pairs of horizontal axes the one is taken along which a sample of a thing's Gaussians fills the smallest
rectangle, if this is below a share of that along the principal axes."""
SPAN = 0.96
"""Share of a thing's weight within its span along a direction."""

# Relations. Chosen on the boxes of simulated scenes, without models (docs/things.md).
CLEAR = 0.5
"""One thing is left of another if its middle lies beyond this share of half the other's extent."""
OVER = 0.5
"""Share of a thing's footprint that must lie over another for it to be on or inside it."""
OVER_PART = 0.25
"""Share of one of two footprints that must lie over the other for the upper thing to be above the lower."""
CONTACT = 0.35
"""Largest gap between the bottom of a thing and what it is on, in units of its height."""
DIRECTIONS, SURROUNDED = 8, 0.75
"""A thing contains another only if it has Gaussians in this share of so many directions around it."""
ENCLOSED = (0.1, 0.25)
"""Of two things that touch, the lower one contains the upper if close to it so large a share of its Gaussians in each
of those directions lie beside it, or of those over its footprint above it. Few of a table's Gaussians are misplaced."""
NEAR = 0.5
"""Things are near each other if the gap between them is at most this share of the larger one's diagonal."""
BETWEEN = (0.15, 0.85, 0.5)
"""A thing is between two others if its place along the line between them lies within the first two, and its distance
from that line is at most this share of their distance."""

# Comparisons of captures. Tuned on simulated pairs and pairs of real models (docs/many_scenes.md).
REACH = 0.05
"""Gaussians lie on each other up to this share of an object's size, or its size over the root of its Gaussians."""
LIKE = (0.2, 0.5)
"""Cosines, less the mean of all things, from which a thing looks like an object a little, and fully."""
GONE = 0.7
"""A thing has gone if this share of it is not there."""
GONE_REGIONS = 6
"""Regions over all levels of what has gone; less is a fragment."""
SEEN = 0.65
"""Share of a place from which it was seen."""
RESIZED = 1.5
"""Times as large as before, that a thing that moved is at most."""
STILL = 0.25
"""Sizes of an object, how far it has to move."""
LOOKED_FOR = 150
"""Gaussians of a thing that are looked for. A limit on time."""
NEAREST = 8
"""Gaussians of the other capture that are tried for each of them."""
LEAST_OPACITY = 0.1
"""Opacity of a Gaussian that something can lie on."""
DEPTH_SIDE = 320
"""Pixels of the longer side of a depth map."""

# Registration of captures. Tuned on simulated pairs of other seeds and pairs of real models (docs/many_scenes.md).
LANDMARKS = 400
"""Things of a capture that are paired, those of most regions. A limit on time and memory."""
CANDIDATES = 5
"""Two things may be a pair if each is among so many that look most like the other."""
SAME_PLACE = (0.5, 0.1)
"""They agree up to this share of a thing's size, and of the median distance of things from their middle."""
TRIPLES, TRIED = 100_000, 4000
"""Triples of pairs that are drawn, and transforms that are tried. Limits on time."""
RIGID = 1.2
"""Largest ratio of the scales that the three sides of a triple give."""
BEST, FITS = 50, 4
"""Transforms that are fitted again to all things that agree, and how often."""
ICP_STEPS, ICP_TRIM = 30, 2.5
"""Steps of ICP, and the multiple of the median distance from which a pair of Gaussians does not count."""
LEAST_AGREEING, AGREEING_SHARE = 4, 0.15
"""So many things and this share have to agree under a transform that was searched for; under another, one and this
share. Where they were tuned, at most 14 of 127 agreed by chance, and at least 53 of 203 in one place."""
SAME_RESIDUAL = 1.1
"""Two captures share a frame if the identity has at most this multiple of the residual."""
