"""Things of a field as a recording for the Rerun viewer: boxes with names, cameras, and the splat as points.

pip install "scoup[rerun]"
python examples/13_things_in_rerun.py FIELD TABLE OUT.rrd "mugs"
rerun OUT.rrd
"""

import sys

import rerun  # pyright: ignore[reportMissingImports]
from scipy.spatial.transform import Rotation

import scoup
from scoup.scene import SH_C0

if len(sys.argv) < 5:
    sys.exit(__doc__)
path, table, out, phrase = sys.argv[1:5]
field = scoup.LanguageField.load(path, words=table)
things = field.things(phrase)
gaussians = field.gaussians

rerun.init("scoup")
rerun.save(out)
rerun.log(
    "scene/splat",
    rerun.Points3D(
        gaussians.means.numpy(),
        colors=(SH_C0 * gaussians.sh[:, 0] + 0.5).clamp(0, 1).numpy(),
        radii=gaussians.scales.mean(1).numpy(),
    ),
    static=True,
)
rerun.log(
    "scene/things",
    rerun.Boxes3D(
        centers=[thing.box.centre.tolist() for thing in things],
        half_sizes=[(thing.box.extent / 2).tolist() for thing in things],
        # The rows of `axes` are the axes of a box; quaternions here are x, y, z, w.
        quaternions=[Rotation.from_matrix(thing.box.axes.T.numpy()).as_quat() for thing in things],
        labels=[thing.text if thing.score is None else f"{thing.text} {thing.score:.2f}" for thing in things],
    ),
    static=True,
)
for camera in field.cameras or ():
    rerun.log(
        ["scene", "cameras", camera.name],
        rerun.Transform3D(translation=camera.position.numpy(), mat3x3=camera.viewmat[:3, :3].T.numpy()),
        rerun.Pinhole(image_from_camera=camera.K.numpy(), resolution=[camera.width, camera.height]),
        static=True,
    )
print(f"{out}: {len(things)} things, {len(field.cameras or ())} cameras")
