"""The protocol of Mip-NeRF 360 with the GAGS annotations: masks from relevancy maps (docs/protocols.md).

Labels are files as in LERF-OVS. Maps are made at the size of the labels (``scoup_lab.baselines.fitted.resized_image``);
the level whose mask has the highest mean relevancy answers. There is no localisation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from torch import Tensor

from scoup.base.errors import InputError
from scoup.query.presets import QueryPreset, query_preset
from scoup.query.segment import segment
from scoup_lab.data.labels import LabelledFrame
from scoup_lab.evaluate.metrics import iou
from scoup_lab.evaluate.protocols.lerf_ovs import maps_by_label
from scoup_lab.evaluate.scores import PairScore, SceneScore, scene_score

PROTOCOL = "mipnerf360 2D"


def preset(system: str = "scoup") -> QueryPreset:
    """The constants of a system for this data set; the level whose mask has the highest mean relevancy answers.

    Raises:
        UnknownNameError: there is no such system, or it names no threshold for Mip-NeRF 360.
    """
    return replace(query_preset(system, "mipnerf360"), level_choice="mask")


def score_frame(
    frame: LabelledFrame,
    relevancy: Mapping[str, Tensor] | Tensor,  # each [S, H, W], or [S, Q, H, W]
    preset: QueryPreset | None = None,
) -> list[PairScore]:
    """Score each label of a frame.

    Args:
        frame: the truth.
        relevancy: per label [S, H, W] in 0..1, or all stacked [S, Q, H, W], at the size of the frame.
        preset: how maps become masks; by default SCOUP's for this data set.

    Raises:
        InputError: a label has no relevancy map, or it is not of the size of the frame.
    """
    settings = preset or _DEFAULT
    pairs = []
    for label, maps in maps_by_label(frame, relevancy):
        if tuple(maps.shape[1:]) != (frame.height, frame.width):
            raise InputError(
                f"frame {frame.name!r} is {frame.width} x {frame.height}, its relevancy {maps.shape[2]} x "
                f"{maps.shape[1]}; features are resized to the label, never the label"
            )
        found = segment(maps, settings)
        score = iou(found.mask.cpu(), frame.masks[label])
        pairs.append(PairScore(frame.name, label, score, None, found.level, -1, found.score, None))
    return pairs


def score_scene(
    scene: str,
    frames: Iterable[tuple[LabelledFrame, Mapping[str, Tensor] | Tensor]],
    preset: QueryPreset | None = None,
) -> SceneScore:
    """Score all frames of a scene, given with their relevancy as for ``score_frame``.

    Raises:
        InputError: there is not a single label.
    """
    settings = preset or _DEFAULT
    pairs = [pair for frame, maps in frames for pair in score_frame(frame, maps, settings)]
    return scene_score(scene, settings.name, pairs, PROTOCOL)


_DEFAULT = preset()
