"""Words, options and outputs that cannot be: one sentence that names what is wrong, and nothing changes."""

from __future__ import annotations

from pathlib import Path

import pytest

from cli_support import ASK, BUILD, refused

pytestmark = pytest.mark.usefixtures("here")


# ---- words


def test_a_word_that_is_not_in_the_table():
    for verb in ("query", "select"):
        message = refused(verb, "f.scoup", "ketle", "--out", "a.ply" if verb == "select" else "answers")
        table = Path("scene/words.npz").absolute()
        assert message.startswith(f"{table}: no text embedding named 'ketle'; nearest names: 'kettle'")
    assert "no text embedding named 'ketle'" in refused(
        "render", "f.scoup", "--what", "relevancy", "--query", "ketle"
    )


def test_blank_texts():
    assert "blank" in refused("query", "f.scoup", " ")
    assert "name at least one text" in refused("query", "f.scoup")


def test_models_that_are_not_there():
    assert "ARCHITECTURE/PRETRAINED" in refused(*ASK["query"], "--text", "open_clip:ViT")


# ---- options


def test_cameras_that_are_not_there():
    for arguments in (ASK["query"], ASK["render"]):
        message = refused(*arguments, "--camera", "view_9")
        assert message.startswith("f.scoup: no camera named 'view_9'; nearest names: 'view_0")


def test_a_field_without_cameras_or_geometry():
    from scoup.field.language_field import LanguageField

    field = LanguageField.load("f.scoup")
    bare = LanguageField(field.code_indices, field.code_weights, field.codebook, field.info)
    bare.save("bare.scoup")
    assert "bare.scoup: does not say where its Gaussians are; name them with --gaussians" in refused(
        "query", "bare.scoup", "kettle"
    )
    assert "bare.scoup: contains no cameras; name a scene that has them with --scene" in refused(
        "query", "bare.scoup", "kettle", "--gaussians", "scene/point_cloud.ply"
    )


@pytest.mark.parametrize(("options", "said"), [
    (("--k", "9"), "k (9) and keep (4) must not exceed the 8 atoms"),
    (("--k", "0"), "k must be at least 1"),
    (("--n-atoms", "0"), "atoms"), (("--n-atoms", "70000"), "70000"),
    (("--epochs", "-1"), "epochs must not be negative"),
    (("--tolerance", "nan"), "tolerance"),
    (("--seed", "-1"), "seed"),
    (("--solver", "magic"), "there is no solver 'magic'; solvers: 'adam'"),
    (("--out", "a.ply"), "a.ply: expected a name that ends in .scoup"),
    (("--out", "scene"), "scene: expected a name that ends in .scoup"),
])  # fmt: skip
def test_settings_out_of_range(options, said):
    assert said in refused(*BUILD, *options)


@pytest.mark.parametrize("number", ["0", "-1", "nan", "inf", "1e9"])
def test_scales_out_of_range(number):
    assert "--scale" in refused(*ASK["query"], "--scale", number)


def test_thresholds_out_of_range():
    assert "the threshold must be 0 to 1" in refused(*ASK["query"], "--threshold", "1.5")


# ---- outputs


def test_outputs_that_cannot_be():
    Path("file").write_text("precious")
    Path("d.scoup").mkdir()
    assert "d.scoup: is a folder" in refused(*BUILD, "--out", "d.scoup", "--overwrite")
    assert "file is not a folder" in refused(*BUILD, "--out", "file/a.scoup")
    assert "file is not a folder" in refused("select", "f.scoup", "kettle", "--out", "file/a.ply")
    assert "file: is a file" in refused("query", "f.scoup", "kettle", "--out", "file", "--overwrite")
    assert "file: is a file" in refused("render", "f.scoup", "--out", "file", "--overwrite")
    assert "several files" in refused("query", "f.scoup", "kettle", "--out", "a.json")
