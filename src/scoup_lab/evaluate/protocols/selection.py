"""The 3D-selection protocol: Gaussians are chosen by their own relevancy, and the silhouette of those chosen meets the
2D label (docs/evaluation.md, after VALA-3D).

Never to be mixed with the 2D protocols: the same field scores very differently (LangSplat has 51.4 there and 9.66
here).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from scoup import raster
from scoup.base import InputError
from scoup.query import TextVectors, select_by_relevancy
from scoup.scene import Camera, Gaussians, nearest_points
from scoup_lab.baselines.fitted import FittedMethod
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.metrics import iou
from scoup_lab.evaluate.protocols.pixels import LabelledScene
from scoup_lab.evaluate.scores import PairScore, SceneScore

PROTOCOL = "3D selection"


RULE = "vala-3d"  # whose constants these are, from relevancy of Gaussians to a silhouette
NEIGHBOURS = 10  # relevancy is blended half and half with the mean of so many neighbours
THRESHOLD = 0.6  # of the rescaled relevancy
OPAQUE = 10 / 255  # a pixel belongs to the silhouette above this opacity


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """The nearest neighbours of some of N points."""

    members: Tensor  # [M] int64, the points that have neighbours and may be one
    nearest: Tensor  # [M, B] int64, the B nearest other members of each, nearest first; B may be 0

    @classmethod
    def of(cls, points: Tensor, included: Tensor, count: int) -> Neighbourhood:
        """Find ``count`` nearest neighbours, without the point itself, of points [N, 3] included [N] and finite."""
        members = (included.cpu() & torch.isfinite(points).all(1).cpu()).nonzero()[:, 0]
        wanted = min(count, max(len(members) - 1, 0))
        nearest = nearest_points(points.cpu()[members].double().numpy(), wanted)[0]
        return cls(members, members[torch.from_numpy(nearest)])

    def blend(self, values: Tensor, included: Tensor) -> Tensor:
        """Return half of each member's value [S, N] and half of the mean over its neighbours included [S, N]; without
        any, values stay.
        """
        out = values.clone()
        for level in range(len(values)):
            counted = included[level].to(values.dtype)
            nearest = self.nearest.to(values.device)
            number = counted[nearest].sum(1)
            mean = (values[level] * counted)[nearest].sum(1) / number.clamp(min=1)
            before = values[level, self.members]
            out[level, self.members] = torch.where(number > 0, 0.5 * (before + mean), before)
        return out


def silhouette(gaussians: Gaussians, chosen: Tensor, camera: Camera, raster_preset: str) -> Tensor:
    """Return [H, W] boolean: where the chosen Gaussians [N], drawn alone, are more opaque than ``OPAQUE``.

    Drawn alone means that nothing hides them: a thing behind another one has its whole silhouette.
    """
    if not chosen.any():
        return torch.zeros(camera.height, camera.width, dtype=torch.bool, device=chosen.device)
    alone = gaussians.select(chosen)
    projection = raster.project(alone, camera, raster_preset)
    nothing = torch.zeros(len(alone), 1, device=alone.device)
    return raster.render_channels(projection, nothing)[1] > OPAQUE


def score_scene(
    scene: str,
    gaussians: Gaussians,
    frames: Iterable[tuple[LabelledFrame, Camera]],
    chosen: Mapping[str, Tensor],
    raster_preset: str = "inria",
) -> SceneScore:
    """Score every label of every frame.

    ``chosen``: label -> [N] boolean, the Gaussians selected for it in the whole scene.
    """
    pairs = []
    for frame, camera in frames:
        truth = frame.resized(camera.width, camera.height)
        for label in frame.labels:
            if label not in chosen:
                raise InputError(f"frame {frame.name!r}: there is no selection for the label {label!r}")
            shape = silhouette(gaussians, chosen[label], camera, raster_preset).cpu()
            # A selection that shows nothing scores 0, even where the truth is empty too.
            score = iou(shape, truth.masks[label]) if shape.any() else 0.0
            pairs.append(PairScore(frame.name, label, score, None, -1, float("nan"), None))
    return SceneScore(scene, RULE, tuple(pairs), PROTOCOL)


def score_method(
    scene: LabelledScene, vectors: TextVectors, fitted: FittedMethod, gaussians: Gaussians, raster_preset: str
) -> SceneScore:
    """Select Gaussians for every label by what a method made of a scene, and score the scene."""
    coded = fitted.coded()
    around = Neighbourhood.of(gaussians.means, coded.any(0), NEIGHBOURS)
    chosen = {}
    for label, query in zip(vectors.texts, vectors.queries, strict=True):
        relevancy = fitted.gaussian_relevancy(query[None], vectors.canonical)[:, 0]
        chosen[label] = select_by_relevancy(around.blend(relevancy, coded), coded, THRESHOLD).mask
    return score_scene(scene.name, gaussians, scene.frames, chosen, raster_preset)
