"""What users type by mistake: one sentence says what is wrong and what to do."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cli_support import ASK, BUILD, refused, run

pytestmark = pytest.mark.usefixtures("here")

TABLE, PLY = "scene/words.npz", "scene/point_cloud.ply"
SELECT, FREE = ("--out", "a.ply"), ("--segmenter", "felzenszwalb", "--embedder", "colors")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((*BUILD, "--model", "scene/README.txt"), "scene/README.txt: is not a table of text embeddings; pass a table"),
        ((*BUILD, "--model", "no model"), "no text model or table file named 'no model'; nearest names: 'FOLDER or h"),
        ((*BUILD, "--model", "a/b/c"), "no text model or table file named 'a/b/c'; nearest names: "),
        ((*ASK["query"], "--text", "no such/model x"), "no text model or table file named 'no such/model x'"),
        (("extract", "scene", "--segmenter", "no such/x"), "no segmenter named 'no such/x'; nearest names: "),
        (("query", "f.scoup", "g.scoup"), "g.scoup: is a field, expected a text; ask one field at a time"),
        (("label", "f.scoup", "scene/README.txt"), "scene/README.txt: is a file, expected a text; type its words"),
        (("query", "f.scoup", "mug across the kettle"), "mug across the kettle: unknown relation 'across'; known"),
        (("label", "f.scoup", "mug and"), "mug and: a text is missing after 'and'"),
        (("query", "scene/README.txt", "mug"), "scene/README.txt: is not a SCOUP language field; pass a .scoup file"),
        (("query", TABLE, "mug"), "words.npz: is not a SCOUP language field; pass a .scoup file; scoup build writes"),
        (("select", "f.scoup", "mug and", *SELECT), "mug and: a text is missing after 'and'; write texts joined by"),
        (("select", "f.scoup", "mug", "and", *SELECT), "mug and: a text is missing after 'and'"),
        (("select", "f.scoup", "(mug or not)", *SELECT), "(mug or not): a text is missing after 'not'"),
        (("select", "f.scoup", "and mug", *SELECT), "and mug: a text is missing before 'and'"),
        (("select", "f.scoup", "()", *SELECT), "(): a text is missing; write texts"),
        (("build", "f.scoup", "--out", "a.scoup"), "f.scoup: is neither a scene nor a splat; pass the folder of cam"),
        (("extract", PLY), f"{PLY}: is a splat, expected photographs; scoup build {PLY} makes views of it first"),
        (("extract", "scene", "--views", "ten"), "invalid views 'ten'; expected a number such as 60, more as +40"),
        (("extract", "scene", "--views", "+4", "--out", "r", *FREE), "r: contains no regions to add to; pass --views"),
        (("extract", "scene", "--images", "scene/sparse"), "folder that their names are relative to as --images"),
        (("views", PLY, "--out", "scene"), "scene: is a scene with other cameras; choose another folder with --out"),
        (("batch", "scene", "--out", "b"), "scene: is a scan, expected a folder of scans; scoup build scene builds"),
        (("batch", TABLE, "--out", "b"), "words.npz: is a file (a folder of scans was expected); check the path"),
        (("archive", "f.scoup", "mug"), "f.scoup: is a file, expected the folder of an archive; check the path"),
        (("archive", "mug", "scans"), "mug: there is no such archive; add fields first"),
        (("archive", "scene", "mug"), "scene: contains no scan; add fields first"),
        (("archive", "scans", "mug", "--top", "0"), "--top must be 1 or more, got 0"),
        (("mcp", "f.scoup", "--archive", "scans"), "scans: there is no such archive; add fields first"),
        (("mcp", "f.scoup", "--text", "scene/README.txt"), "scene/README.txt: is not a table of text embeddings; pass"),
    ],
)  # fmt: skip
def test_mistakes(arguments, said):
    Path("scene/README.txt").write_text("A scene of a kettle and a mug.\n")
    assert said in refused(*arguments)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ((), "bare: has cameras, but none of their photographs was found"),
        (("--sums", "s"), "make them with scoup extract bare, or name their folder with --features"),
    ],
)
def test_a_scene_without_regions_and_photographs(options, said):
    shutil.copytree("scene", "bare", ignore=shutil.ignore_patterns("language_features", "images"))
    code, _, err = run("build", "bare", "--out", "a.scoup", *options)
    assert code == 2
    assert said in err


def test_no_option_is_said_to_take_none():
    code, out, _ = run("views", PLY, "--views", "all", "--json")
    assert code == 2
    assert "--views: invalid literal for int() with base 10: 'all'" in out
    assert "None" not in out


def test_a_field_that_names_nothing_to_encode_texts_is_warned_of():
    assert "a.scoup: names nothing that can encode texts; build with --model" in run(*BUILD)[2]
    assert "encode texts" not in run(*BUILD, "--model", TABLE, "--overwrite")[2]


def test_a_list_of_words_in_utf_16():
    Path("words.txt").write_text("mug\nkettle\n", "utf-16")
    assert run("catalog", "f.scoup", "--words", "words.txt")[0] == 0


@pytest.mark.parametrize(
    ("model", "said"),
    [(None, "a.scoup: names no embedding model; pass a word table or model as --text"),
     ("colors", "a.scoup: these regions were embedded by their colours, without a model, and cannot be queried")],
)  # fmt: skip
@pytest.mark.parametrize("verb", ["query a.scoup mug", "mcp a.scoup", "archive b --add a.scoup"])
def test_fields_that_no_text_can_ask(model, said, verb):
    assert run(*BUILD, *(() if model is None else ("--model", model)))[0] == 0
    assert said in refused(*verb.split())
