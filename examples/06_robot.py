"""Locate a thing for a robot: position, size and score in the world, and in the frame of the camera that sees it best.

    python examples/06_robot.py demo/demo.scoup demo/scene/text.npz teapot

The field knows the length of its unit in metres from `scoup frame FIELD --thing door --longest-side 2.0`.
A robot should act only on what is present, with a score high enough for its purpose.
"""

import sys

import scoup

if len(sys.argv) < 4:
    sys.exit(__doc__)
path, words, thing = sys.argv[1:4]
field = scoup.LanguageField.load(path, words=words)
place = field.location(thing)
print(f"{thing}: {place.describe()}")

views = [field.at(camera).show([place.answer])[0] for camera in field.cameras or ()]
best = max(views, key=lambda view: view.coverage, default=None)
if place.position is not None and best is not None:
    print(f"visible in {sum(view.visible for view in views)} of {len(views)} views")
    viewmat = field.camera(best.view).viewmat
    in_camera = viewmat[:3, :3] @ place.position + viewmat[:3, 3]
    x, y, z = (in_camera * (field.world.metres_per_unit or 1.0)).tolist()
    unit = "m" if field.world.metres_per_unit else "scene units"
    print(f"from {best.view}: {x:.3f} to the right, {y:.3f} down, {z:.3f} ahead ({unit}); pixel {best.point}")
