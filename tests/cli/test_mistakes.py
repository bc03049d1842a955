"""What users type by mistake, option by option: one sentence says what is wrong and what to do, and nothing changes."""

from __future__ import annotations

import os
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cli_support import BUILD, refused, run
from io_samples import write_inria_cameras
from scoup.io import load_cameras, load_gaussians, save_gaussians, write_colmap
from scoup.query import LanguageField
from scoup.scene import Cameras
from support import make_camera, random_gaussians

PLY, TABLE = "scene/point_cloud.ply", "scene/words.npz"
FREE = "--segmenter felzenszwalb --embedder colors"
TABLES = "pass a table (.npz with names and vectors, .json with name: numbers, or .safetensors"
BUILT = "build scene --n-atoms 8 --out a.scoup"
MISTAKES: dict[str, list[tuple[str, str]]] = {
    BUILT: [
        ("--k 9", "k (9) and keep (4) must not exceed the 8 atoms"),
        ("--k 0", "k must be at least 1"),
        ("--n-atoms 0", "atoms"), ("--n-atoms 70000", "70000"),
        ("--out a.ply", "a.ply: expected a name that ends in .scoup"),
        ("--out scene", "scene: expected a name that ends in .scoup"),
        ("--out d.scoup --overwrite", "d.scoup: is a folder"),
        ("--out file/a.scoup", "file is not a folder"),
        ("--gaussians no.ply", "no.ply: there is no such file or folder (a trained splat was expected); check"),
        ("--gaussians f.scoup", "f.scoup: is not a kind of splat"),
        ("--features no", "no: there is no such folder (a folder of region features was expected); make them"),
        (f"--features {PLY}", "is a file, not a folder"),
        ("--features r --embedder colors", "--features names some; pass either"),
        ("--images no", "no: there is no such folder of images; check the path"),
        ("--model no.npz", "no.npz: there is no such file"),
        ("--model scene/README.txt", "scene/README.txt: is not a table of text embeddings; pass a table"),
        ("--model 'no model'", "no text model or table file named 'no model'; nearest names: 'FOLDER or h"),
        ("--model a/b/c", "no text model or table file named 'a/b/c'; nearest names: "),
        ("--sums no.sums", "no.sums: there is no such folder"),
        ("--sums f.scoup", "f.scoup: is not a folder of region sums"),
        ("--sums scene/images --overwrite", "scene/images: is not a folder of region sums"),
        ("--sums s --keep-sums s", "not both"),
        ("--keep-sums file --overwrite", "file: cannot be written"),
        ("--codebook no.scoup", "no.scoup: there is no such file"),
    ],
    "build": [
        ("scene/images --out a.scoup", "use the scene it is in: scene"),
        ("trained/point_cloud/iteration_30000 --out a.scoup", "use the scene it is in: trained"),
        ("all --out a.scoup", "use one of the scenes in it: all/kitchen"),
        ("f.scoup --out a.scoup", "f.scoup: is neither a scene nor a splat; pass the folder of cam"),
        ("scene/sparse/0/cameras.bin --out a.scoup",
         "cameras.bin: is not a splat, and none is named; name the trained splat with --gaussians"),
        (f"{PLY} --gaussians {PLY}", "is a splat; pass the scene"),
        (f"{PLY} --part 1/2", "make its scene first, with scoup views and scoup extract"),
        ("ckpt_9_rank0.pt --part 1/2", "make its scene first"),
        ("scene --part 1/2", "pass --keep-sums"),
        ("scene --part 3/2 --keep-sums parts", "expected I/N"),
        *((f"scene --part 1/2 --keep-sums parts {option} {value}", f"pass {option} to scoup build --sums")
          for option, value in (("--n-atoms", 8), ("--model", "m/m"), ("--codebook", "f.scoup"), ("--out", "a.scoup"))),
    ],
    "query f.scoup kettle --out answers": [
        ("--text open_clip:ViT", "ARCHITECTURE/PRETRAINED"),
        ("--text 'no such/model x'", "no text model or table file named 'no such/model x'"),
        *((f"--text {name}", f"{name}: is not a table of text embeddings; {TABLES}")
          for name in ("scene/language_features/view_00_f.npy", "gone.pt", "words.csv", "scene/README.txt")),
        ("--camera view_9", "f.scoup: no camera named 'view_9'; nearest names: 'view_0"),
        ("--scene no", "no: there is no such file or folder (a scene was expected); check the path"),
        ("--gaussians no.ply", "no.ply: there is no such file or folder (a trained splat was expected); check"),
        ("--gaussians others.ply", "others.ply: not the geometry this field was built on (as many Gaussians, but"),
        ("--gaussians few.ply", "few.ply: not the geometry this field was built on (30 Gaussians, the field has 150)"),
        ("--threshold 1.5", "the threshold must be 0 to 1"),
        ("--metres-per-unit -1", "--metres-per-unit must be above 0"),
        ("--longest-side 0", "--longest-side must be above 0, got 0.0"),
        ("--longest-side 0.25 --metres-per-unit 1", "not both"),
        ("--out file --overwrite", "file: is a file"),
        ("--out a.json", "several files"),
    ],
    "query": [
        ("f.scoup", "name at least one text"), ("f.scoup ' '", "blank"),
        ("f.scoup ketle", "scene/words.npz: no text embedding named 'ketle'; nearest names: 'kettle'"),
        ("f.scoup kettle kettle --coco", "two texts are equal"),
        ("no.scoup kettle", "no.scoup: there is no such file"),
        ("f.scoup g.scoup", "g.scoup: is a field, expected a text; ask one field at a time"),
        ("f.scoup 'mug across the kettle'", "mug across the kettle: unknown relation 'across'; known"),
        ("scene mug", "scene: is a folder"),
        (f"{PLY} kettle", "point_cloud.ply: is not a SCOUP language field"),
        ("scene/README.txt mug", "scene/README.txt: is not a SCOUP language field; pass a .scoup file"),
        (f"{TABLE} mug", "words.npz: is not a SCOUP language field; pass a .scoup file; scoup build writes"),
        ("bare.scoup kettle", "bare.scoup: does not say where its Gaussians are; name them with --gaussians"),
        (f"bare.scoup kettle --gaussians {PLY}",
         "bare.scoup: contains no cameras; name a scene that has them with --scene"),
    ],
    "select f.scoup kettle --out a.ply": [
        ("--out file/a.ply", "file is not a folder"),
        ("--out a.obj", "cannot write Gaussians as .obj"),
        (f"--out {PLY} --overwrite", "use another name"),
        ("--out a.splat --edit state", "no column of states"), ("--out a.scoup --edit state", "no column of states"),
        ("--text no.json", "no.json: there is no such file"),
        ("--gaussians others.ply", "not the geometry this field was built on (as many Gaussians, but others)"),
        ("--color red", "expected #rrggbb"),
        ("--opacity 2", "--opacity must be 0 to 1"),
        ("--picture a.jpg", "ends in .png"),
        ("--metres-per-unit 0", "--metres-per-unit must be above 0"),
        ("--edit remove --within 1000", "try a higher --threshold"),
        ("--threshold 1", "a.ply: nothing to write, 0 of 150 Gaussians answer; try a lower --threshold"),
        ("--threshold nan", "threshold must be 0 to 1"),
        ("--presence 1.5", "presence must be 0 to 1, got 1.5"),
        ("--presence 0.5", "presence is judged against 16 or more"),
        ("--level xl", "'xl'"),
        *((f"{option} -1", option[2:]) for option in ("--grow", "--shrink", "--within")),
    ],
    "select f.scoup --out a.ply": [
        ("", "name at least one text"), ("ketle", "no text embedding named 'ketle'"),
        ("'mug and'", "mug and: a text is missing after 'and'; write texts joined by"),
        ("mug and", "mug and: a text is missing after 'and'"),
        ("'(mug or not)'", "(mug or not): a text is missing after 'not'"),
        ("'and mug'", "and mug: a text is missing before 'and'"),
        ("'()'", "(): a text is missing; write texts"),
        *((words, "for example") for words in ("'kettle and'", "'(kettle'", "kettle not mug")),
        ("'mug not on the kettle'", "mug not on the kettle: 'not' must follow 'and' or 'or'; write texts"),
        *((words, "an operator is missing beside a bracket; put a text that contains brackets in double quotes")
          for words in ("'kettle (blue)'", "'(blue) kettle'")),
        ("'(kettle'", "a bracket is not closed"), ("'kettle)'", "a bracket is closed that was not opened"),
        ("'mug opposite the kettle'", "known relations"),
    ],
    "render f.scoup": [
        ("--what relevancy", "belong together"), ("--query kettle", "belong together"),
        ("--what relevancy --query ketle", "no text embedding named 'ketle'"),
        ("--what codes --level x", "there is no level 'x'; expected one of s, m, l"),
        ("--camera view_9", "f.scoup: no camera named 'view_9'; nearest names: 'view_0"),
        ("--gaussians others.ply", "not the geometry this field was built on (as many Gaussians, but others)"),
        *((f"--scale {number}", "--scale") for number in ("0", "nan", "inf", "-3", "1e9")),
        ("--out file --overwrite", "file: is a file"),
        ("--out b.png --camera all", "one picture cannot hold 4 views"),
        ("--out film.mp4 --camera all", "several files"),
        ("--scene other --camera all --out a.gif", "the views differ in size"),
        *((f"--device {name}", f"--device {name}") for name in ("cuda:99", "toaster", "meta")),
    ],
    "label f.scoup": [
        ("", "name at least one text"), ("spoon", "no text embedding named 'spoon'"),
        ("'mug and'", "mug and: a text is missing after 'and'"),
        ("scene/README.txt", "scene/README.txt: is a file, expected a text; type its words"),
        ("kettle --out f.scoup", "is a file"),
        ("kettle --threshold 2", "threshold must be 0 to 1"),
        ("kettle --outputs maps --camera view_99", "view_99"),
        ("--words missing.txt", "expected"), ("--words empty.txt", "contains no word"),
        ("mug --words phrase.txt", "named 'mug on the kettle'"),
    ],
    "label blind.scoup kettle --text scene/words.npz": [("--outputs maps", "contains no cameras")],
    "catalog f.scoup": [("--up 0 0 0", "not all 0")],
    "catalog blind.scoup --text scene/words.npz": [("", "contains no things")],
    f"extract scene {FREE}": [
        ("--points-per-side 0", "points_per_side"),
        (f"--out r --embedder {PLY}", "it is a file; pass a folder with config.json"),
        ("--out file", "is a file"), ("--part x", "expected I/N"), ("--concepts nothing.txt", "nothing.txt"),
        ("--views some", "such as 60"), ("--views +1 --part 1/2", "--part"),
        ("--views +4 --out r", "r: contains no regions to add to; pass --views"),
    ],
    "extract": [
        ("", "or --list"), (f"nowhere {FREE}", "there is no such scene"),
        (f"scene/language_features {FREE}", "contains no photographs"),
        ("scene --views ten", "invalid views 'ten'; expected a number such as 60, more as +40"),
        ("scene --images scene/sparse", "folder that their names are relative to as --images"),
        ("scene --segmenter 'no such/x'", "no segmenter named 'no such/x'; nearest names: "),
        ("scene --show other", "nearest names"), ("--show view_02", "or --list"),
        ("scene --segmenter ./no-such-model", "felzenszwalb"),
        ("scene --segmenter felzenszwalb --embedder ./no-such-model", "colors"),
        (PLY, f"{PLY}: is a splat, expected photographs; scoup build {PLY} makes views of it first"),
        ("'a splat.ply'", "scoup build 'a splat.ply' makes views of it first"),
    ],
    f"views {PLY}": [
        ("--views 0", "--views must be 1 to 1000 views, got 0"),
        ("--width 4", "--width must be 16 to 8192 pixels, got 4"),
        ("--up 0 0 0", "up: expected three numbers that are not all 0"),
        ("--out scene", "scene: is a scene with other cameras; choose another folder with --out"),
    ],
    "views": [("nothing.ply", "nothing.ply: there is no such file")],
    "convert": [
        ("features.npy a.scoup", "--gaussians"),
        (f"features.npy folder --gaussians {PLY}", "ends in .scoup"),
        (f"features.npy a.scoup --gaussians {PLY}", "not one row for each of 150 Gaussians"),
        ("scene/README.txt a.scoup", "cannot be converted"), (f"{TABLE} a.scoup", "cannot be converted"),
        ("none there", "none: there is no such f"),
        (f"{PLY} {PLY} --overwrite", "is the source"),
        ("a.usdz b.ply", ".usdz files are not read"),
        *((f"{folders} {options}", said) for options in ("", "--overwrite") for folders, said in (
            ("scene scene", "source and target are one folder; use a new folder, such as scene/language_features_"),
            ("scene/language_features scene",
             "scene: contains other files than region features (README.txt, images, point_cloud"),
            ("scene scene/images",
             "scene/images: contains other files than region features (view_00.png, view_01.png"))),
    ],
    "transfer f.scoup": [
        ("no.ply", "no.ply"), (PLY, "nothing to do"),
        ("edited.ply --out there.ply", "expected a name that ends in .scoup"),
        ("away.ply", "away.ply: none of its Gaussians lies in one of the field's"),
    ],
    "batch": [
        ("nowhere --out f", "nowhere"), ("empty --out f", "no folders of scans"),
        ("empty --out f --jobs 0", "--jobs"), ("empty --out f --jobs 2 --ray auto", "without --ray"),
        ("scene --out b", "scene: is a scan, expected a folder of scans; scoup build scene builds"),
        (f"{TABLE} --out b", "words.npz: is a file (a folder of scans was expected); check the path"),
    ],
    "archive": [
        ("f.scoup mug", "f.scoup: is a file, expected the folder of an archive; check the path"),
        ("mug scans", "mug: there is no such archive; add fields first"),
        ("scene mug", "scene: contains no scan; add fields first"),
        ("scans mug --top 0", "--top must be 1 or more, got 0"),
        ("scans mug --list", "scans: pass one of TEXT, --image, --add, --remove and --list"),
        ("scans --list --page b.html", "--page is for TEXT and --image"),
        ("scans mug --set floor=2", "--set is for --add"),
        ("scans --add f.scoup --set floor", "--set floor: expected NAME=VALUE"),
        ("scans --add f.scoup f.scoup", "expected .scoup files with different names"),
        ("scans --image a.png --presence 0.5", "--at-least and --presence are for texts"),
    ],
    "view f.scoup": [
        ("--export page.txt", "page.txt: expected a name that ends in .html"),
        ("--export f.scoup", "expected a name that ends in .html"),
        ("--split", "--split belongs to --export"),
        ("--port 70000", "--port must be 0 to 65535"),
    ],
    "words": [
        ("--out words.json", "words.json: tables are written as .npz"),
        (f"--model {TABLE}", "words.npz: is a word table, not a model; pass the model that made it"),
        ("--words none.txt", "none.txt: there is no such file (a list of words was expected)"),
        ("--words scene", "scene: is a folder, not a list of words"),
    ],
    "compare f.scoup": [
        ("f.scoup --transform scene/README.txt", "scene/README.txt: its content"),
        ("no.scoup", "no.scoup: there is no such file"),
    ],
    "mcp f.scoup": [
        ("f.scoup", "expected .scoup files with different names"),
        ("--out f.scoup", "f.scoup: is a file; name a folder"),
        ("--words list.txt", "no text embedding named 'dragon'"),
        ("--http 70000", "--http must be 0 to 65535"),
        ("--archive scans", "scans: there is no such archive; add fields first"),
        ("--text scene/README.txt", "scene/README.txt: is not a table of text embeddings; pass"),
    ],
    "info": [
        ("nowhere", "there is no such file or folder"), ("empty", "contains nothing that SCOUP reads"),
        ("scene/images", "use the scene it is in: scene"),
        ("all", "use one of the scenes in it: all/kitchen"),
        ("a.xyz", "a.xyz: is not a known kind of file"),
    ],
    "": [
        (f"{BUILT} --out f.scoup", "f.scoup: already exists; pass --overwrite"),
        ("transfer f.scoup edited.ply --out f.scoup", "f.scoup: already exists; pass --overwrite"),
        (f"convert features.npy f.scoup --gaussians {PLY}", "f.scoup: already exists; pass --overwrite"),
        (f"convert {PLY} few.ply", "few.ply: already exists; pass --overwrite"),
        ("convert scene packed --model my/model", "view_00.regions: already exists"),
        ("query f.scoup kettle --out there", "sheet.png: already exists"),
        ("query f.scoup kettle --out drawn --pictures all", "kettle_heat.png: already exists"),
        (f"select f.scoup kettle --out {PLY}", f"{PLY}: already exists; pass --overwrite"),
        ("label f.scoup kettle --out there", "labels.json: already exists"),
        ("catalog f.scoup --out there", "catalog.json: already exists"),
        ("compare f.scoup f.scoup --out there", "compare.json: already exists"),
        ("render f.scoup --camera all --out there", "view_01.png: already exists"),
        ("render f.scoup --camera all --out there/a.gif", "a.gif: already exists"),
        (f"views {PLY} --views 1 --width 24 --height 18 --out there", "transforms.json: already exists"),
    ],
}  # fmt: skip
UNREAD = {
    "a.lcc": ("x", "splats in .lcc files are not read; convert it with splat-transform (splat-transform a.lcc a.ply), "
              "or open it in the SuperSplat editor"),
    "a.usdz": ("x", ".usdz files are not read, whether they hold a splat or a mesh; export the trained splat as PLY"),
    "a.usd": ("x", ".usd files are not read, whether they hold a splat or a mesh; export the trained splat as PLY"),
    "a.las": ("x", "a .las file contains a mesh or a point cloud, not a trained splat; use the splat that training"),
    "a.ply.gz": ("x", "is an archive; unpack it"),
    "list/transforms.json": ('[{"file_path": "a.png"}]',
                             "[0].img_name is missing, expected a text; a JSON list is read as cameras of"),
    "cut/transforms.json": ("[1,", "is not valid JSON (line 1); the file should contain cameras of nerfstudio (an obj"),
    "object/cameras.json": ('{"a": 1}', "frames is missing, expected a list; a JSON object is read as nerfstudio's"),
    "other.json": ('{"frames": [{}]}', "frames[0].file_path is missing, expected a text; a JSON object is read as"),
}  # fmt: skip
"""Files of other kinds: what is in them, and what is said of them."""
PIPES = {
    "pipe.ply": ("convert pipe.ply b.spz", f"{BUILT} --gaussians pipe.ply"),
    "pipe.scoup": ("query pipe.scoup kettle --out o",),
    "pipe.npz": ("query f.scoup kettle --text pipe.npz --out o",),
    "pipe.txt": ("view f.scoup --words pipe.txt --export a.html",),
    "pipe.npy": (f"convert pipe.npy b.scoup --gaussians {PLY}",),
    "pipe.json": ("info pipe.json",),
}
CASES = [(f"{start} {more}", said) for start, rows in MISTAKES.items() for more, said in rows]
for name, (_, said) in UNREAD.items():
    CASES += [(f"info {name}", f"{name}: {said}"), (f"{BUILT} --gaussians {name}", f"{name}: {said}")]
    if name.endswith(".json"):
        CASES[-1] = (f"build {name} --gaussians {PLY} --out a.scoup", f"{name}: {said}")
        CASES.append((f"extract {name}", f"{name}: {said}"))
if hasattr(os, "mkfifo"):
    CASES += [
        (one, f"{name}: is a named pipe (FIFO), not ") for name, commands in PIPES.items() for one in commands
    ]


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
        contents = {
            "scene/README.txt": "A scene of a kettle and a mug.\n", "file": "precious", "a.xyz": "x",
            "empty.txt": "\n", "list.txt": "dragon\n", "phrase.txt": "mug\nmug on the kettle\n",
            **{name: content for name, (content, _) in UNREAD.items()},
        }  # fmt: skip
        for name in ("d.scoup", "empty", "list", "cut", "object"):
            Path(name).mkdir()
        for name, content in contents.items():
            Path(name).write_text(content)
        for name in PIPES if hasattr(os, "mkfifo") else ():
            os.mkfifo(name)
        Path("there").mkdir()
        records = ("labels.json", "catalog.json", "compare.json", "transforms.json")
        for name in ("sheet.png", "view_01.png", "a.gif", *records):
            Path("there", name).touch()
        Path("drawn/view_00").mkdir(parents=True)
        Path("drawn/view_00/kettle_heat.png").touch()
        assert run("convert", "scene", "packed", "--model", "my/model")[0] == 0
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


@pytest.mark.parametrize(("command", "said"), CASES, ids=[command for command, _ in CASES])
def test_a_mistake_is_one_sentence(
    mistaken: Path, monkeypatch: pytest.MonkeyPatch, command: str, said: str
) -> None:
    if "felzenszwalb" in command:
        pytest.importorskip("skimage")
    monkeypatch.chdir(mistaken)
    assert said in refused(*shlex.split(command))


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(("options", "said"), [
    ((), "bare one: has cameras, but none of their photographs was found"),
    (("--sums", "s"), "make them with scoup extract 'bare one', or name their folder with --features"),
])  # fmt: skip
def test_a_scene_without_regions_and_photographs(options, said):
    shutil.copytree("scene", "bare one", ignore=shutil.ignore_patterns("language_features", "images"))
    code, _, err = run("build", "bare one", "--out", "a.scoup", *options)
    assert code == 2
    assert said in err


def test_no_option_is_said_to_take_none():
    code, out, _ = run("views", PLY, "--views", "all", "--json")
    assert code == 2
    assert "--views: invalid literal for int() with base 10: 'all'" in out
    assert "None" not in out


@pytest.mark.usefixtures("here")
def test_a_field_that_names_nothing_to_encode_texts_is_warned_of():
    assert "a.scoup: names nothing that can encode texts; build with --model" in run(*BUILD)[2]
    _, out, warned = run(*BUILD, "--model", TABLE, "--overwrite")
    assert "encode texts" not in warned
    assert "ask it: scoup query a.scoup WORD" in out


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize(
    ("model", "said"),
    [(None, "a.scoup: names no embedding model; pass a word table or model as --text"),
     ("colors", "a.scoup: these regions were embedded by their colours, without a model, and cannot be queried")],
)  # fmt: skip
@pytest.mark.parametrize("verb", ["query a.scoup mug", "mcp a.scoup", "archive b --add a.scoup"])
def test_fields_that_no_text_can_ask(model, said, verb):
    assert run(*BUILD, *(() if model is None else ("--model", model)))[0] == 0
    assert said in refused(*verb.split())
