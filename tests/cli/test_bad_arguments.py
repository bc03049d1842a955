"""Words, options and outputs that cannot be: one sentence that names what is wrong, and nothing changes."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cli_support import ASK, BUILD, WORDS, refused
from scoup.models.word_table import save_table
from scoup.models.words import CANONICAL_PHRASES

pytestmark = pytest.mark.usefixtures("here")


# ---- words


def test_a_word_that_is_not_in_the_table():
    for verb in ("query", "select"):
        message = refused(verb, "f.scoup", "ketle", "--out", "a.ply" if verb == "select" else "answers")
        assert message.startswith("scene/words.npz: no text embedding named 'ketle'; nearest names: 'kettle'")
    assert "no text embedding named 'ketle'" in refused(
        "render", "f.scoup", "--what", "relevancy", "--query", "ketle"
    )


def test_a_table_of_another_dimension():
    names = [*WORDS, *CANONICAL_PHRASES]
    save_table("wide.npz", names, np.random.default_rng(0).normal(size=(len(names), 24)))
    for arguments in ASK.values():
        message = refused(*arguments, "--text", "wide.npz")
        assert "wide.npz: has vectors of 24 dimensions, but the field contains embeddings of 16" in message


def test_a_table_without_the_canonical_phrases():
    save_table("bare.npz", WORDS, np.random.default_rng(0).normal(size=(len(WORDS), 16)))
    message = refused(*ASK["query"], "--text", "bare.npz")
    assert message.startswith(
        "bare.npz: lacks 'object', but relevancy compares every text with the phrases object, things"
    )


def test_blank_texts():
    assert "blank" in refused("query", "f.scoup", " ")
    assert "name at least one text" in refused("query", "f.scoup")


def test_models_that_are_not_there(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "open_clip", None)
    message = refused(*ASK["query"], "--text", "open_clip:ViT-B-16/laion2b_s34b_b88k")
    assert "pip install 'scoup[open-clip]'" in message
    assert "ARCHITECTURE/PRETRAINED" in refused(*ASK["query"], "--text", "open_clip:ViT")
    monkeypatch.setitem(sys.modules, "transformers", None)
    assert "pip install 'scoup[models]'" in refused(*ASK["query"], "--text", "some/model")


def test_a_model_that_cannot_be_fetched(monkeypatch):
    pytest.importorskip("transformers")
    from huggingface_hub import constants

    monkeypatch.setattr(constants, "HF_HUB_OFFLINE", True)
    message = refused(*ASK["query"], "--text", "nobody/has-this-model")
    assert "text model 'nobody/has-this-model' cannot be loaded" in message
    assert "use a table file" in message


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
    assert "bare.scoup: holds no cameras; name a scene that has them with --scene" in refused(
        "query", "bare.scoup", "kettle", "--gaussians", "scene/point_cloud.ply"
    )


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--k", "9"), "k (9) and keep (4) must not exceed the 8 atoms"),
        (("--k", "0"), "k must be at least 1"),
        (("--n-atoms", "0"), "atoms"),
        (("--n-atoms", "70000"), "70000"),
        (("--epochs", "-1"), "epochs must not be negative"),
        (("--tolerance", "nan"), "tolerance"),
        (("--seed", "-1"), "seed"),
        (("--solver", "magic"), "there is no solver 'magic'; solvers: 'adam'"),
        (("--out", "a.ply"), "a.ply: give a name that ends in .scoup"),
        (("--out", "scene"), "scene: give a name that ends in .scoup"),
    ],
)
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


def test_folders_that_may_not_be_written_to(monkeypatch):
    Path("locked").mkdir()
    locked = Path("locked").absolute()
    access = os.access  # the tests may run as root, who may write everywhere
    monkeypatch.setattr(
        os, "access", lambda path, mode, **rest: Path(path) != locked and access(path, mode, **rest)
    )
    for arguments in (
        (*BUILD, "--out", "locked/a.scoup"),
        ("query", "f.scoup", "kettle", "--out", "locked/deep"),
        ("select", "f.scoup", "kettle", "--out", "locked/a.ply"),
        ("render", "f.scoup", "--out", "locked"),
    ):
        assert "is read-only for you; choose another folder" in refused(*arguments)
