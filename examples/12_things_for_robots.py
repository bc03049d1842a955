"""Things of a field as vision_msgs/Detection3DArray in JSON, in metres and in the frame of a map.

    python examples/12_things_for_robots.py FIELD TABLE "mugs"

The axes are those of REP 103: x forward (away from the camera that sees the most), y left, z up; the origin is that of
the scene. Metres, up and the name of the frame are those of `scoup frame FIELD`. For a map of your own, replace
ROTATION and TRANSLATION: map = UNIT * ROTATION @ scene + TRANSLATION. The covariance is that of a point anywhere in the
box; zeros for the orientation mean not estimated.
"""

import json
import sys
import time

import torch
from scipy.spatial.transform import Rotation

import scoup
from scoup.query import Thing

if len(sys.argv) < 4:
    sys.exit(__doc__)
path, table, phrase = sys.argv[1:4]
field = scoup.LanguageField.load(path, words=table)
UNIT = field.world.metres_per_unit or 0.0
if not UNIT:
    sys.exit(f"{path}: has no metre; run scoup frame {path} --thing door --longest-side 2.0")
right, up, away = field.frame().axes
ROTATION = torch.stack([away, -right, up])
TRANSLATION = torch.zeros(3, dtype=torch.float64)
seconds, nanoseconds = divmod(time.time_ns(), 10**9)
HEADER = {"stamp": {"sec": seconds, "nanosec": nanoseconds}, "frame_id": field.world.name or "map"}


def named(vector: torch.Tensor, names: str = "xyz") -> dict[str, float]:
    return dict(zip(names, vector.tolist(), strict=True))


def detection(thing: Thing) -> dict:
    axes = thing.box.axes @ ROTATION.T  # of the box in the map, one per row
    size = UNIT * thing.box.extent
    quaternion = Rotation.from_matrix(axes.T.numpy()).as_quat(canonical=True)
    pose = {
        "position": named(UNIT * ROTATION @ thing.box.centre + TRANSLATION),
        "orientation": named(torch.from_numpy(quaternion), "xyzw"),
    }
    covariance = torch.zeros(6, 6, dtype=torch.float64)
    covariance[:3, :3] = axes.T @ torch.diag(size**2 / 12) @ axes
    # The score is None where presence was not judged, for lack of everyday words.
    result = {
        "hypothesis": {"class_id": thing.text, "score": thing.score},
        "pose": {"pose": pose, "covariance": covariance.flatten().tolist()},
    }
    box = {"center": pose, "size": named(size)}
    return {"header": HEADER, "id": str(thing.number), "results": [result], "bbox": box}


detections = [detection(thing) for thing in field.things(phrase)]
print(json.dumps({"header": HEADER, "detections": detections}, indent=1))
