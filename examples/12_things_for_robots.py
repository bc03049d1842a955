"""Things of a field as vision_msgs/Detection3DArray in JSON, in metres and in the frame of a map.

    python examples/12_things_for_robots.py FIELD TABLE METRES_PER_UNIT "how many mugs"

For a map in another frame, replace ROTATION and TRANSLATION: map = METRES_PER_UNIT * ROTATION @ scene + TRANSLATION.
"""

import json
import math
import sys

import torch

import scoup

ROTATION = torch.eye(3, dtype=torch.float64)
TRANSLATION = torch.zeros(3, dtype=torch.float64)


def quaternion(axes: torch.Tensor) -> dict[str, float]:
    """The rotation whose columns are the axes [3, 3] of a box, one per row, as x, y, z, w."""
    m = axes.T
    values, vectors = torch.linalg.eigh(
        torch.stack(
            [
                torch.stack(
                    [m[0, 0] - m[1, 1] - m[2, 2], m[1, 0] + m[0, 1], m[2, 0] + m[0, 2], m[2, 1] - m[1, 2]]
                ),
                torch.stack(
                    [m[1, 0] + m[0, 1], m[1, 1] - m[0, 0] - m[2, 2], m[2, 1] + m[1, 2], m[0, 2] - m[2, 0]]
                ),
                torch.stack(
                    [m[2, 0] + m[0, 2], m[2, 1] + m[1, 2], m[2, 2] - m[0, 0] - m[1, 1], m[1, 0] - m[0, 1]]
                ),
                torch.stack([m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1], m.trace()]),
            ]
        )
    )
    x, y, z, w = vectors[:, int(values.argmax())].tolist()
    sign = math.copysign(1, w)
    return {"x": sign * x, "y": sign * y, "z": sign * z, "w": sign * w}


def point(vector: torch.Tensor) -> dict[str, float]:
    return dict(zip("xyz", vector.tolist(), strict=True))


path, table, metres_per_unit, phrase = sys.argv[1], sys.argv[2], float(sys.argv[3]), sys.argv[4]
field = scoup.LanguageField.load(path)
things = field.things(field.question(phrase, encoder=table, always=True) if phrase.isalpha() else phrase)
detections = [
    {
        "id": str(thing.number),
        "results": [{"hypothesis": {"class_id": thing.text, "score": thing.confidence}}],
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
