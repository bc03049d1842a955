"""The LERF-OVS protocol: 2D masks and points from relevancy maps, against hand-drawn labels
(docs/protocols.md).

Not to be mixed with the 3D-selection protocol: the same field scores very differently there.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from torch import Tensor

from scoup.base.counts import counted
from scoup.base.errors import InputError
from scoup.query.presets import QUERY_PRESETS, QueryPreset
from scoup.query.segment import localize_and_segment
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.metrics import any_inside, iou
from scoup_lab.evaluate.scores import PairScore, SceneScore, scene_score

PROTOCOL = "lerf-ovs 2D"


def score_frame(
    frame: LabelledFrame,
    relevancy: Mapping[str, Tensor] | Tensor,  # each [S, H, W], or [S, Q, H, W]
    preset: QueryPreset = QUERY_PRESETS["scoup"],
) -> list[PairScore]:
    """Score each label of a frame.

    Args:
        frame: the truth; resized to the size of the relevancy maps (masks nearest) if they differ.
        relevancy: per label of the frame [S, H, W] in 0..1 (a mapping may make them on access), or all
            stacked in the order of ``frame.labels``, [S, Q, H, W].
        preset: how maps become masks and points. The protocol's default is "scoup", which chooses the level as the
            paper does; everyday queries (``segment``) choose it otherwise.

    Raises:
        InputError: a label has no relevancy map.
    """
    return [_score_pair(frame, label, maps, preset) for label, maps in maps_by_label(frame, relevancy)]


def maps_by_label(
    frame: LabelledFrame, relevancy: Mapping[str, Tensor] | Tensor
) -> Iterator[tuple[str, Tensor]]:
    """Each label of a frame with its relevancy maps [S, H, W], from the forms that ``score_frame`` takes.

    Raises:
        InputError: a label has no relevancy map.
    """
    if isinstance(relevancy, Tensor) and (relevancy.dim() != 4 or relevancy.shape[1] != len(frame.labels)):
        raise InputError(
            f"frame {frame.name!r} has {counted(len(frame.labels), 'label')}, its relevancy is "
            f"{list(relevancy.shape)}; expected [S, labels, H, W]"
        )
    for position, label in enumerate(frame.labels):
        if isinstance(relevancy, Tensor):
            yield label, relevancy[:, position]
        elif label in relevancy:
            yield label, relevancy[label]
        else:
            raise InputError(f"frame {frame.name!r}: there is no relevancy map for the label {label!r}")


def _score_pair(frame: LabelledFrame, label: str, maps: Tensor, preset: QueryPreset) -> PairScore:
    localization, segmentation = localize_and_segment(maps, preset)
    truth = frame.only(label).resized(maps.shape[2], maps.shape[1])
    return PairScore(
        frame=frame.name,
        label=label,
        iou=iou(segmentation.mask.cpu(), truth.masks[label]),
        hit=any_inside(localization.pixels.cpu(), truth.boxes[label]),
        level=segmentation.level,
        localization_level=localization.level,
        score=segmentation.score,
        pixel=localization.pixel,
    )


def score_scene(
    scene: str,
    frames: Iterable[tuple[LabelledFrame, Mapping[str, Tensor] | Tensor]],
    preset: QueryPreset = QUERY_PRESETS["scoup"],
) -> SceneScore:
    """Score all frames of a scene, given with their relevancy as for ``score_frame`` (a generator is fine), by
    default with the paper's own rules, preset "scoup".

    Raises:
        InputError: there is not a single label.
    """
    pairs = [pair for frame, relevancy in frames for pair in score_frame(frame, relevancy, preset)]
    return scene_score(scene, preset.name, pairs, PROTOCOL)
