"""The protocol of Mip-NeRF 360 with the GAGS annotations: masks from relevancy maps (docs/evaluation.md).

Labels are files as in LERF-OVS. Maps are made at the size of the labels (``scoup_lab.baselines.fitted.resized_image``);
the level whose mask has the highest mean relevancy answers. There is no localisation.
"""

from __future__ import annotations

from scoup_lab.evaluate.protocols.lerf_ovs import label_folder, read_labelled_frames
from scoup_lab.evaluate.protocols.pixels import PixelProtocol

PROTOCOL = PixelProtocol(
    "mipnerf360",
    "mipnerf360 2D",
    scenes=("room", "counter", "garden", "bonsai"),
    labels=label_folder,
    read=read_labelled_frames,
    thresholds={"scoup": 0.45, "langsplatv2": 0.4},
    level_choice="mask",
    at_label_size=True,
)
