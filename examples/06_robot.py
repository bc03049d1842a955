"""Locate a thing for a robot: position, size and score in the world, and in the frame of the camera that sees it best.

    python examples/06_robot.py demo/demo.scoup demo/scene/text.npz teapot 0.25

The last argument is the length of the scene's unit in metres (`scoup query FIELD door --longest-side 2.0` measures it).
A robot should act only on what is present, with a score high enough for its purpose.
"""

import sys

import scoup

if len(sys.argv) < 5:
    sys.exit(__doc__)
path, words, thing, metres_per_unit = sys.argv[1:5]
field = scoup.LanguageField.load(path, words=words)
place = field.location(thing)
print(f"{thing}: {place.describe(float(metres_per_unit))}")

views = [field.at(camera).show([place.answer])[0] for camera in field.cameras or ()]
best = max(views, key=lambda view: view.coverage, default=None)
if place.position is not None and best is not None:
    print(f"visible in {sum(view.visible for view in views)} of {len(views)} views")
    viewmat = field.camera(best.view).viewmat
    x, y, z = ((viewmat[:3, :3] @ place.position + viewmat[:3, 3]) * float(metres_per_unit)).tolist()
    print(f"from {best.view}: {x:.3f} m to the right, {y:.3f} m down, {z:.3f} m ahead; pixel {best.point}")
