"""Things of a field as vision_msgs/Detection3DArray in JSON, in metres and in the frame of a map.

    python examples/12_things_for_robots.py FIELD TABLE METRES_PER_UNIT "how many mugs"

For a map in another frame, replace ROTATION and TRANSLATION: map = METRES_PER_UNIT * ROTATION @ scene + TRANSLATION.
"""

import json
import sys

import torch
from scipy.spatial.transform import Rotation

import scoup

ROTATION = torch.eye(3, dtype=torch.float64)
TRANSLATION = torch.zeros(3, dtype=torch.float64)


def quaternion(axes: torch.Tensor) -> dict[str, float]:
    """The rotation whose columns are the axes [3, 3] of a box, one per row, as x, y, z, w."""
    turn = Rotation.from_matrix(axes.T.numpy()).as_quat(canonical=True)
    return dict(zip("xyzw", turn.tolist(), strict=True))


def point(vector: torch.Tensor) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


if len(sys.argv) < 5:
    sys.exit(__doc__)
path, table, metres_per_unit, phrase = sys.argv[1], sys.argv[2], float(sys.argv[3]), sys.argv[4]
field = scoup.LanguageField.load(path)
field.text_encoder(table)
things = field.things(phrase)
detections = [
    {
        "id": str(thing.number),
        # None where presence was not judged, for lack of everyday words.
        "results": [{"hypothesis": {"class_id": thing.text, "score": thing.score}}],
        "bbox": {
            "center": {
                "position": point(metres_per_unit * ROTATION @ thing.box.centre + TRANSLATION),
                "orientation": quaternion(thing.box.axes @ ROTATION.T),
            },
            "size": point(metres_per_unit * thing.box.extent),
        },
    }
    for thing in things
]
print(json.dumps({"header": {"frame_id": "map"}, "detections": detections}, indent=1))
