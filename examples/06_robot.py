"""Where is it, for a robot: position, size and confidence in the world, and in the camera's own frame.

    python examples/06_robot.py demo/demo.scoup demo/scene/text.npz teapot 0.25

The last argument is the length of the scene's unit in metres; measure something you know to find it. A robot should
act only on what is present, and confident enough for its purpose.
"""

import sys

import scoup

path, words, thing, metres_per_unit = sys.argv[1:5]
field = scoup.LanguageField.load(path)
field.text_encoder(words)
found = field.finding(thing)

if not found.presence or found.position is None:
    print(f"{thing}: not in this scene (z-score {found.location.answer.z_score})")
    sys.exit()
print(f"{thing}: {found.location.said(float(metres_per_unit))}")
print(f"seen in {sum(answer.presence for answer in found.answers)} of {len(found.answers)} views")
if found.best is not None and field.cameras is not None:
    camera = field.cameras[found.best.view]
    rotation, translation = camera.viewmat[:3, :3], camera.viewmat[:3, 3]
    x, y, z = ((rotation @ found.position + translation) * float(metres_per_unit)).tolist()
    print(
        f"from {camera.name}: {x:.3f} m to the right, {y:.3f} m down, {z:.3f} m ahead; pixel {found.best.point}"
    )
