"""Words: simulated text vectors and image prototypes of the names of a scene, with the statistics of CLIP.

No model has made these vectors. They follow a stated procedure, so that the demo needs no download:

* Text. All texts share a mean direction; the rest of a vector is the concept of the word. A concept is a random
  direction, mixed with the concept of the object for a part, and with those of the members for a group. The canonical
  phrases ("object", "things", "stuff", "texture") share one concept. Two names then have a cosine of about 0.57, the
  median of names in CLIP's text space.
* Images. All images share another mean direction, nearly at right angles to that of the texts: the gap between the
  modalities. Each thing has a prototype: the mean image direction plus a random direction of its own, mixed as the
  concepts are. Prototypes of unrelated things have a cosine of about 0.55.
* Text with image. Each prototype is moved along the concepts until its cosine with its own name is a number drawn
  from 0.26 to 0.31, and every other prototype stays clearly below that for the same name, as all do for words of what
  is not there. Other pairs of text and image have a cosine of about 0.18, canonical phrases and images of about 0.2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scoup.scene import LEVELS
from scoup_lab.synthetic.art.meshes import Floats
from scoup_lab.synthetic.art.things import Parts

CANONICAL = ("object", "things", "stuff", "texture")
DISTRACTORS = (
    "bicycle", "elephant", "guitar", "refrigerator", "umbrella", "horse", "traffic light", "sink",
    "toothbrush", "piano", "snowboard", "zebra", "helmet", "keychain", "washing machine", "tent", "violin",
    "sailboat",
)  # fmt: skip
DIMENSIONS = 512
TEXT_MEAN = 0.755  # share of the mean direction in a text vector
IMAGE_MEAN = 0.74  # the same of an image prototype
MODALITY_COSINE = 0.32  # between the two mean directions
PHRASE_CONCEPT = 0.45  # share of the common concept in a canonical phrase
OWN_COSINE = (0.26, 0.31)  # text and prototype of the same name
MARGIN = 0.055  # how far below its own prototype all others stay for a name
RELATED_MARGIN = 0.02  # the same for parts of the thing, and the groups it belongs to
CANONICAL_COSINE, CANONICAL_SPREAD = 0.193, 0.012  # a canonical phrase and a prototype


@dataclass(frozen=True, eq=False)
class Words:
    """Text vectors, and image prototypes of the names of a scene."""

    texts: tuple[str, ...]  # all words that have a vector
    vectors: Floats  # [texts, D] float64, unit norm
    prototypes: dict[str, Floats]  # for each level, [names at that level, D] float64, unit norm

    def vector(self, text: str) -> Floats:
        """Return [D] unit vector of a word."""
        return self.vectors[self.texts.index(text)]


def unit(vectors: Floats) -> Floats:
    """Return rows of length 1; zero rows stay."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def make_words(parts: Parts, rng: np.random.Generator) -> Words:
    """Return text vectors of every name, canonical phrase and distractor, and image prototypes of the names."""
    names = tuple(dict.fromkeys(name for level in LEVELS for name in parts.names(level)))
    kin = _kinship(parts, names)
    text_mean, image_mean, common = unit(rng.normal(size=(3, DIMENSIONS)))
    image_mean = unit(image_mean - (image_mean @ text_mean) * text_mean)
    image_mean = MODALITY_COSINE * text_mean + np.sqrt(1 - MODALITY_COSINE**2) * image_mean

    words = (*names, *DISTRACTORS, *CANONICAL)
    concepts = unit(rng.normal(size=(len(words), DIMENSIONS)))
    concepts[: len(names)] = unit(kin @ concepts[: len(names)])
    concepts[-len(CANONICAL) :] = unit(
        np.sqrt(1 - PHRASE_CONCEPT) * concepts[-len(CANONICAL) :] + np.sqrt(PHRASE_CONCEPT) * common
    )
    vectors = unit(TEXT_MEAN * text_mean + np.sqrt(1 - TEXT_MEAN**2) * concepts)

    appearances = unit(kin @ unit(rng.normal(size=(len(names), DIMENSIONS))))
    prototypes = unit(IMAGE_MEAN * image_mean + np.sqrt(1 - IMAGE_MEAN**2) * appearances)
    prototypes = _named(prototypes, vectors, kin, rng)
    absent = slice(len(names), -len(CANONICAL))
    vectors[absent] = _kept_away(vectors[absent], prototypes)
    return Words(
        words,
        vectors,
        {level: prototypes[[names.index(name) for name in parts.names(level)]] for level in LEVELS},
    )


def _kinship(parts: Parts, names: tuple[str, ...]) -> Floats:
    """Return [names, names], the share of each name's own random direction in a name's concept."""
    kin = np.eye(len(names))
    for part, owner in zip(parts.parts, parts.object_of_part, strict=True):
        if part != parts.objects[owner]:
            kin[names.index(part), names.index(parts.objects[owner])] = 0.8
    for group_number, group in enumerate(parts.groups):
        members = [
            name for name, of in zip(parts.objects, parts.group_of_object, strict=True) if of == group_number
        ]
        if group not in parts.objects:
            for member in members:
                kin[names.index(group), names.index(member)] = 0.8 / np.sqrt(len(members))
    return kin


def _named(prototypes: Floats, vectors: Floats, kin: Floats, rng: np.random.Generator) -> Floats:
    """Move prototypes [n, D] along text vectors [words, D], names first, until each name is nearest to its own."""
    count = len(prototypes)
    cosines = rng.uniform(*OWN_COSINE, count)
    related = (kin > 0) | (kin.T > 0) | (kin @ kin.T > 0)
    limit = np.full((count, len(vectors)), np.inf)
    limit[:, :count] = np.where(related, cosines - RELATED_MARGIN, cosines - MARGIN)
    canonical = rng.normal(CANONICAL_COSINE, CANONICAL_SPREAD, (count, len(CANONICAL)))
    diagonal = np.arange(count)
    concepts = unit(vectors - vectors.mean(0))
    slope = np.einsum("nd,nd->n", concepts, vectors)
    for _ in range(60):
        excess = prototypes @ vectors.T - limit
        step = -excess.clip(0)
        # The phrases are so similar that steps towards each of them add up.
        step[:, -len(CANONICAL) :] = 0.25 * (canonical - prototypes @ vectors[-len(CANONICAL) :].T)
        step[diagonal, diagonal] = cosines - np.einsum("nd,nd->n", prototypes, vectors[:count])
        prototypes = unit(prototypes + 0.5 * (step / slope) @ concepts)
    return prototypes


def _kept_away(vectors: Floats, prototypes: Floats) -> Floats:
    """Return text vectors [words, D] of what is not there, moved until they are as far from all prototypes
    as other names."""
    back = np.linalg.pinv(prototypes).T
    for _ in range(20):
        vectors = unit(vectors - (vectors @ prototypes.T - (OWN_COSINE[0] - MARGIN)).clip(0) @ back)
    return vectors
