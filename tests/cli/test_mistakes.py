"""What users type by mistake: one sentence says what is wrong and what to do."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cli_support import ASK, BUILD, refused, run

pytestmark = pytest.mark.usefixtures("here")

TABLE = "scene/words.npz"
SELECT = ("--out", "a.ply")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((*BUILD, "--model", "scene/README.txt"), "scene/README.txt: is not a table of text embeddings; pass a table"),
        ((*BUILD, "--model", "no model"), "no text model or table file named 'no model'; nearest names: 'FOLDER or h"),
        ((*BUILD, "--model", "a/b/c"), "no text model or table file named 'a/b/c'; nearest names: "),
        ((*ASK["query"], "--text", "no such/model x"), "no text model or table file named 'no such/model x'"),
        (("extract", "scene", "--segmenter", "no such/x"), "no segmenter named 'no such/x'; nearest names: "),
        (("query", "f.scoup", "g.scoup"), "g.scoup: is a field, expected a text; ask one field at a time"),
        (("query", "f.scoup", "mug across the kettle"), "mug across the kettle: unknown relation 'across'; known"),
        (("label", "f.scoup", "mug and"), "mug and: a text is missing after 'and'"),
        (("query", "scene/README.txt", "mug"), "scene/README.txt: is not a SCOUP language field; pass a .scoup file"),
        (("query", TABLE, "mug"), "words.npz: is not a SCOUP language field; pass a .scoup file; scoup build writes"),
        (("select", "f.scoup", "mug and", *SELECT), "mug and: a text is missing after 'and'; write texts joined by"),
        (("select", "f.scoup", "mug", "and", *SELECT), "mug and: a text is missing after 'and'"),
        (("select", "f.scoup", "(mug or not)", *SELECT), "(mug or not): a text is missing after 'not'"),
        (("select", "f.scoup", "and mug", *SELECT), "and mug: a text is missing before 'and'"),
        (("select", "f.scoup", "()", *SELECT), "(): a text is missing; write texts"),
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


def test_a_field_that_names_nothing_to_encode_texts_is_warned_of():
    assert "a.scoup: names nothing that can encode texts; build with --model" in run(*BUILD)[2]
    assert "encode texts" not in run(*BUILD, "--model", TABLE, "--overwrite")[2]


def test_a_list_of_words_in_utf_16():
    Path("words.txt").write_text("mug\nkettle\n", "utf-16")
    assert run("catalog", "f.scoup", "--words", "words.txt")[0] == 0
