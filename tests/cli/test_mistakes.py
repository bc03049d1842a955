"""What users do by mistake, verb by verb: one sentence says what is wrong and what to do, and nothing changes.

The sentences are in tests/messages.json.
"""

from __future__ import annotations

import os
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from cli_support import BUILD, FREE, refused, run, run_json, write_scene
from io_samples import write_inria_cameras
from messages import check_message
from scoup.io import load_cameras, load_gaussians, save_gaussians
from scoup.query import LanguageField
from scoup.scene import Cameras
from scoup_lab.data.colmap_model import write_colmap
from support import make_camera, random_gaussians

PLY, PHOTO, TABLE = "scene/point_cloud.ply", "scene/images/view_01.png", "scene/words.npz"
BUILT = "build scene --n-atoms 8 --out a.scoup"
QUERY = "query f.scoup kettle --out answers"
SELECT = "select f.scoup kettle --out a.ply"
RENDER = "render f.scoup --what relevancy --query kettle --out answers"
EXTRACT = f"extract scene {' '.join(FREE)}"
PIPES = {
    "pipe.ply": ["convert pipe.ply b.spz", f"{BUILT} --gaussians pipe.ply"],
    "pipe.scoup": ["query pipe.scoup kettle --out o"],
    "pipe.npz": ["query f.scoup kettle --text pipe.npz --out o"],
    "pipe.txt": ["view f.scoup --words pipe.txt --export a.html"],
    "pipe.npy": [f"convert pipe.npy b.scoup --gaussians {PLY}"],
    "pipe.json": ["info pipe.json"],
} if hasattr(os, "mkfifo") else {}  # fmt: skip
"""Named pipes, and verbs that would wait for them."""
MISTAKES: dict[str, list[str]] = {
    BUILT: [
        "--k 9", "--k 0", "--n-atoms 0", "--n-atoms 70000", "--out a.ply", "--out scene",
        "--out d.scoup --overwrite", "--out file/a.scoup", "--gaussians no.ply", "--gaussians f.scoup",
        "--features no", "--features scene/point_cloud.ply", "--features r --embedder colors", "--images no",
        "--model no.npz", "--model scene/README.txt", "--model 'no model'", "--model a/b/c",
        "--sums no.sums", "--sums f.scoup", "--sums scene/images --overwrite", "--sums s --keep-sums s",
        "--codebook no.scoup", "--sums s --no-masks",
    ],
    "build": [
        "scene/images --out a.scoup", "trained/point_cloud/iteration_30000 --out a.scoup",
        "all --out a.scoup", "f.scoup --out a.scoup", "scene/sparse/0/cameras.bin --out a.scoup",
        "scene/point_cloud.ply --gaussians scene/point_cloud.ply", "scene/point_cloud.ply --part 1/2",
        "ckpt_9_rank0.pt --part 1/2", "scene --part 1/2", "scene --part 3/2 --keep-sums parts",
        "scene --part 1/2 --keep-sums parts --n-atoms 8", "scene --part 1/2 --keep-sums parts --model m/m",
        "scene --part 1/2 --keep-sums parts --codebook f.scoup",
        "scene --part 1/2 --keep-sums parts --out a.scoup",
    ],
    QUERY: [
        "--text open_clip:ViT", "--text 'no such/model x'", "--text scene/language_features/view_00_f.npy",
        "--text gone.pt", "--text words.csv", "--text scene/README.txt", "--camera view_9", "--scene no",
        "--gaussians no.ply", "--gaussians others.ply", "--gaussians few.ply", "--threshold 1.5",
        "--out file --overwrite", "--out a.json",
    ],
    "query": [
        "f.scoup", "f.scoup ' '", "f.scoup ketle", "f.scoup kettle kettle --coco", "no.scoup kettle",
        "f.scoup g.scoup", "f.scoup 'mug across the kettle'", "scene mug", "scene/point_cloud.ply kettle",
        "scene/README.txt mug", "scene/words.npz mug", "bare.scoup kettle",
        "bare.scoup kettle --gaussians scene/point_cloud.ply",
    ],
    SELECT: [
        "--out file/a.ply", "--out a.obj", "--out scene/point_cloud.ply --overwrite", "--out f.scoup --overwrite",
        "--out a.splat --edit state", "--out a.scoup --edit state", "--text no.json",
        "--gaussians others.ply", "--color red", "--opacity 2", "--picture a.jpg",
        "--edit remove --within 1000", "--threshold 1", "--threshold nan", "--presence 1.5",
        "--presence 0.5", "--level xl", "--grow -1", "--shrink -1", "--within -1",
    ],
    "select f.scoup --out a.ply": [
        "", "ketle", "'mug and'", "mug and", "'(mug or not)'", "'and mug'", "'()'", "'kettle and'",
        "'(kettle'", "kettle not mug", "'mug not on the kettle'", "'kettle (blue)'", "'(blue) kettle'",
        "'kettle)'", "'mug opposite the kettle'",
        "'mug right of the mug' --always --seen-from view_01",
    ],
    "render f.scoup": [
        "--what relevancy", "--query kettle", "--what relevancy --query ketle", "--what codes --level x",
        "--camera view_9", "--gaussians others.ply", "--scale 0", "--scale nan", "--scale inf", "--scale -3",
        "--scale 1e9", "--out file --overwrite", "--out b.png --camera all", "--out film.mp4 --camera all",
        "--scene other --camera all --out a.gif",
    ],
    "label f.scoup": [
        "", "spoon", "'mug and'", "scene/README.txt", "kettle --out f.scoup", "kettle --threshold 2",
        "kettle --outputs maps --camera view_99", "--words missing.txt", "--words empty.txt",
        "mug --words phrase.txt",
    ],
    "label blind.scoup kettle --text scene/words.npz": ["--outputs maps"],
    "frame f.scoup": [
        "--metres-per-unit -1", "--metres-per-unit nan", "--metres-per-unit inf", "--up 0 0 0", "--up nan 0 1",
        "--origin 91 0 0", "--origin 0 0 inf", "--up y --north 0 1 0.001", "--thing kettle", "--longest-side 1",
        "--thing kettle --longest-side 0", "--thing kettle --distance 1", "--thing kettle --other kettle --distance 1",
        "--thing ketle --longest-side 1", "--metres-per-unit 1 --thing kettle --longest-side 1",
    ],
    "frame": ["no.scoup", "scene/point_cloud.ply --metres-per-unit 1"],
    "catalog blind.scoup --text scene/words.npz": [""],
    EXTRACT: [
        "--points-per-side 0", "--out r --embedder scene/point_cloud.ply", "--out file", "--part x",
        "--concepts nothing.txt", "--views some", "--views +1 --part 1/2", "--views +4 --out r",
    ],
    "extract": [
        "", "nowhere --segmenter felzenszwalb --embedder colors",
        "scene/language_features --segmenter felzenszwalb --embedder colors", "scene --views ten",
        "scene --images scene/sparse", "scene --segmenter 'no such/x'", "scene --show other", "scene --show view_02",
        "--show view_02", "scene/point_cloud.ply", "'a splat.ply'",
    ],
    "views scene/point_cloud.ply": ["--views 0", "--width 4", "--up 0 0 0", "--out scene"],
    "views": ["nothing.ply"],
    "convert": [
        "features.npy a.scoup", "features.npy folder --gaussians scene/point_cloud.ply",
        "features.npy a.scoup --gaussians scene/point_cloud.ply", "scene/README.txt a.scoup",
        "scene/words.npz a.scoup", "none there", "scene/point_cloud.ply scene/point_cloud.ply --overwrite",
        "a.usdz b.ply", "scene scene ", "scene/language_features scene ", "scene scene/images ",
        "scene scene --overwrite", "scene/language_features scene --overwrite",
        "scene scene/images --overwrite",
    ],
    "transfer f.scoup": ["no.ply", "scene/point_cloud.ply", "edited.ply --out there.ply", "away.ply"],
    "batch": [
        "nowhere --out f", "empty --out f", "empty --out f --jobs 0", "empty --out f --jobs 2 --ray auto",
        "scene --out b", "scene/words.npz --out b",
    ],
    "archive": [
        "f.scoup mug", "mug scans", "scene mug", "scans mug --top 0", "scans mug --list",
        "scans --list --page b.html", "scans mug --set floor=2", "scans --add f.scoup --set floor",
        "scans --add f.scoup f.scoup", "scans --image a.png --presence 0.5",
    ],
    "view f.scoup": [
        "--export page.txt", "--export f.scoup", "--export there/page.html", "--split", "--port 70000",
        "--words list.txt", "--text missing.npz",
    ],
    "words": [
        "--out words.json", "--model scene/words.npz", "--model clip --out there/words.npz", "--words none.txt",
        "--words scene",
    ],
    "compare f.scoup": ["f.scoup --transform scene/README.txt", "no.scoup"],
    "mcp f.scoup": [
        "f.scoup", "--out f.scoup", "--words list.txt", "--http 70000", "--archive scans",
        "--text scene/README.txt",
    ],
    "info": ["nowhere", "empty", "scene/images", "all", "a.xyz"],
    "": [
        "build scene --out f.scoup", "transfer f.scoup edited.ply --out f.scoup",
        "convert features.npy f.scoup --gaussians scene/point_cloud.ply",
        "convert scene/point_cloud.ply few.ply", "convert scene packed --model my/model",
        "query f.scoup kettle --out there", "query f.scoup kettle --out drawn --pictures all",
        "select f.scoup kettle --out scene/point_cloud.ply", "label f.scoup kettle --out there",
        "catalog f.scoup --out there", "compare f.scoup f.scoup --out there",
        "render f.scoup --camera all --out there", "render f.scoup --camera all --out there/a.gif",
        "views scene/point_cloud.ply --views 1 --width 24 --height 18 --out there",
    ],
}  # fmt: skip
UNREAD = {
    **dict.fromkeys(("a.lcc", "a.usdz", "a.usd", "a.las", "a.ply.gz"), "x"),
    "list/transforms.json": '[{"file_path": "a.png"}]', "cut/transforms.json": "[1,",
    "object/cameras.json": '{"a": 1}', "other.json": '{"frames": [{}]}',
}  # fmt: skip
"""Files of other kinds, and what is in them."""
CASES = [f"{start} {more}".strip() for start, rows in MISTAKES.items() for more in rows]
CASES += [command for commands in PIPES.values() for command in commands]
for unread in UNREAD:
    CASES += [f"info {unread}", f"build {unread} --gaussians {PLY} --out a.scoup", f"extract {unread}"]
    if unread.startswith("a."):
        CASES[-2:] = [f"{BUILT} --gaussians {unread}"]


@pytest.fixture(scope="module")
def mistaken(original: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of ``original`` with what the mistakes need; no mistake changes it."""
    folder = Path(shutil.copytree(original, tmp_path_factory.mktemp("mistakes") / "here"))
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        shutil.copytree("scene", "all/kitchen")
        iteration = Path("trained/point_cloud/iteration_30000")
        iteration.mkdir(parents=True)
        shutil.copy(PLY, iteration)
        write_inria_cameras(load_cameras("scene"), "trained/cameras.json")
        for name in ("d.scoup", "empty", "list", "cut", "object", "there", "drawn/view_00"):
            Path(name).mkdir(parents=True)
        contents = {
            "scene/README.txt": "A scene of a kettle and a mug.\n", "file": "precious", "a.xyz": "x",
            "empty.txt": "\n", "list.txt": "dragon\n", "phrase.txt": "mug\nmug on the kettle\n", **UNREAD,
        }  # fmt: skip
        for name, content in contents.items():
            Path(name).write_text(content)
        for name in PIPES:
            os.mkfifo(name)
        records = ("labels.json", "catalog.json", "compare.json", "transforms.json", "words.npz", "page.html")
        for name in ("sheet.png", "view_01.png", "a.gif", *records):
            Path("there", name).touch()
        Path("drawn/view_00/kettle_heat.png").touch()
        Path("view_02_regions.png").touch()
        run_json("convert", "scene", "packed", "--model", "my/model")
        splat, field = load_gaussians(PLY), LanguageField.load("f.scoup")
        for name, gaussians in (("others", random_gaussians(150, 5)), ("few", random_gaussians(30, 5)),
                                ("edited", splat.select(slice(5, None))),
                                ("away", replace(splat, means=splat.means + 1000))):  # fmt: skip
            save_gaussians(gaussians, f"{name}.ply")
        parts = (field.code_indices, field.code_weights, field.codebook, field.info)
        LanguageField(*parts).save("bare.scoup")
        LanguageField(*parts, field.gaussians).save("blind.scoup")
        np.save("features.npy", np.ones((149, 16), np.float32))
        write_colmap(
            Cameras([make_camera(name="a.png"), make_camera(64, 48, name="b.png")]), "other/sparse/0"
        )
    return folder


@pytest.mark.parametrize("command", CASES)
def test_a_mistake_is_one_sentence(mistaken: Path, monkeypatch: pytest.MonkeyPatch, command: str) -> None:
    monkeypatch.chdir(mistaken)
    check_message(refused(*shlex.split(command)))


@pytest.mark.parametrize(("command", "said"), [
    *((f"render f.scoup --device {name}", f"--device {name}: this torch (") for name in ("cuda:99", "toaster", "meta")),
    ("extract scene --segmenter ./no-such-model", "or pass --segmenter felzenszwalb, which needs no model"),
    ("extract scene --segmenter felzenszwalb --embedder ./no-such-model", "or pass --embedder colors, which needs no"),
    (f"{BUILT} --keep-sums file --overwrite", "file: cannot be written ("),
    ("words --model nobody/none", "text model 'nobody/none' cannot be loaded"),
])  # fmt: skip
def test_mistakes_of_which_the_machine_says_more(
    mistaken: Path, monkeypatch: pytest.MonkeyPatch, command: str, said: str
) -> None:
    monkeypatch.chdir(mistaken)
    assert said in refused(*shlex.split(command))


# ---- files that are missing, damaged, or of another scene


def gone(file: str) -> None:
    shutil.rmtree(file) if Path(file).is_dir() else Path(file).unlink()


def each_array(kind: str, change: Callable[[np.ndarray], np.ndarray]) -> None:
    for path in Path("scene/language_features").glob(f"*_{kind}.npy"):
        np.save(path, change(np.load(path)))


def fewer_dimensions() -> None:
    each_array("f", lambda rows: rows[:, :8])
    run_json(*BUILD[:-1], "small.scoup")


def sums_and_another_scene() -> None:
    run_json(*BUILD[:-1], "b.scoup", "--keep-sums", "a.sums")
    write_scene(Path("second"), seed=4)


def cameras_that_see_nothing() -> None:
    cameras = Cameras(make_camera(name=f"view_0{number}.png") for number in range(4))
    for camera in cameras:
        camera.viewmat[2, 3] = -1000
    write_colmap(cameras, "scene/sparse/0", overwrite=True)


def no_splat() -> None:
    LanguageField.load("f.scoup", load_gaussians(PLY)).save("whole.scoup", embed_geometry=True)
    gone(PLY)


def no_cameras_and_regions() -> None:
    gone("scene/language_features")
    gone("scene/sparse")


def unreadable_photographs() -> None:
    for number in range(4):
        Path(f"scene/images/view_0{number}.png").write_text("these are not the bytes you are looking for\n")


def regions_of_three_views() -> None:
    run_json("convert", "scene", "regions")
    gone("scene/images/view_03.png")
    gone("regions/view_03.regions")


CHANGES: dict[str, tuple[Callable[[], object], list[str]]] = {
    "no scene": (lambda: gone("scene"), [BUILT]),
    "no splat": (no_splat, [
        BUILT, QUERY, SELECT, "render f.scoup", "compare f.scoup f.scoup", "compare whole.scoup f.scoup"]),
    "no cameras": (lambda: gone("scene/sparse"), [BUILT]),
    "no regions": (lambda: gone("scene/language_features"), [f"{BUILT} --sums s"]),
    "no words": (lambda: gone(TABLE), [QUERY]),
    "embeddings of another model": (fewer_dimensions, [
        f"{BUILT} --model {TABLE}", f"query small.scoup kettle --text {TABLE}"]),
    "views without any region": (lambda: each_array("s", lambda labels: np.full_like(labels, -1)), [BUILT]),
    "region sums of another scene": (sums_and_another_scene, [
        f"build second --n-atoms 8 --out c.scoup {option} a.sums" for option in ("--sums", "--keep-sums")]),
    "cameras that see nothing": (cameras_that_see_nothing, [
        BUILT, f"{QUERY} --scene scene --camera all", f"{RENDER} --scene scene --camera all"]),
    "nothing to choose photographs by": (no_cameras_and_regions, [f"{EXTRACT} --views 2"]),
    "unreadable photographs": (unreadable_photographs, [f"{EXTRACT} --out regions/of/it"]),
    "a view without regions": (regions_of_three_views, ["extract scene --show view_03 --out regions"]),
}  # fmt: skip


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("change", "commands"), CHANGES.values(), ids=CHANGES)
def test_inputs_that_do_not_serve(change: Callable[[], object], commands: list[str]) -> None:
    change()
    for command in commands:
        check_message(refused(*shlex.split(command)))


def bare_scene() -> None:
    shutil.copytree("scene", "bare one", ignore=shutil.ignore_patterns("language_features", "images"))


def splat_without_finite_values() -> None:
    gaussians = random_gaussians(20, 0)
    gaussians.means[:] = torch.nan
    save_gaussians(gaussians, "nan.ply")


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("change", "command"), [
    (bare_scene, "build 'bare one' --out a.scoup"), (bare_scene, "build 'bare one' --out a.scoup --sums s"),
    (splat_without_finite_values, f"{BUILT} --gaussians nan.ply"),
])  # fmt: skip
def test_mistakes_after_a_warning(change: Callable[[], object], command: str) -> None:
    change()
    code, _, err = run(*shlex.split(command))
    assert (code, err.splitlines()[-1][:7]) == (2, "error: ")
    assert not Path("a.scoup").exists()
    check_message(err)


def test_no_option_is_said_to_take_none() -> None:
    said = run("views", PLY, "--views", "all", "--json")[1]
    assert "--views: invalid literal for int() with base 10: 'all'" in said
    assert "None" not in said


@pytest.mark.usefixtures("here")
def test_a_field_that_names_nothing_to_encode_texts_is_warned_of() -> None:
    check_message(run(*BUILD)[2])
    _, out, warned = run(*BUILD, "--model", TABLE, "--overwrite")
    assert "encode texts" not in warned
    assert "ask it: scoup query a.scoup WORD" in out


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("model", [(), ("--model", "colors")])
def test_fields_that_no_text_can_ask(model: tuple[str, ...]) -> None:
    run_json(*BUILD, *model)
    for verb in ("query a.scoup mug", "mcp a.scoup", "archive b --add a.scoup"):
        check_message(refused(*verb.split()))
