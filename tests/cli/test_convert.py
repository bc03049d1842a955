"""scoup convert and words: region features, what other systems leave, and words of a model."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pytest
import torch

from cli_support import BUILD, printed, refused, run_json, warned
from foreign_samples import LangSplatAutoencoder, save_langsplatv2
from scoup.io import load_cameras, load_gaussians, load_regions
from scoup.models import CANONICAL_PHRASES, EVERYDAY_WORDS, TextEncoder, WordTable
from scoup.query import LanguageField
from tiny_models import save_text_clip

pytestmark = pytest.mark.usefixtures("here")


def test_features_become_a_field_that_can_be_queried():
    field = LanguageField.load("f.scoup")
    np.save("features.npy", field.gaussian_features("m").numpy())
    command = shlex.split("convert features.npy new.scoup --gaussians scene/point_cloud.ply --n-atoms 8")
    out = printed(*command, "--model", "scene/words.npz")
    assert "new.scoup: 150 Gaussians, 8 atoms, levels m (mean cosine" in out
    assert run_json("info", "new.scoup")["geometry"].endswith("point_cloud.ply")
    texts = field.with_encoder("scene/words.npz").question("kettle")
    pair = [LanguageField.load(path).gaussian_relevancy(texts.queries, texts.canonical)[level, 0]
            for path, level in (("f.scoup", 1), ("new.scoup", 0))]  # fmt: skip
    assert torch.corrcoef(torch.stack(pair))[0, 1] > 0.9


def test_checkpoints_of_langsplatv2_become_a_field():
    gaussians = load_gaussians("scene/point_cloud.ply")
    for level in (1, 2, 3):
        save_langsplatv2(gaussians, Path(f"out/kitchen_{level}/chkpnt10000.pth"), seed=level)
    record = run_json("convert", "out/kitchen_2/chkpnt10000.pth", "v2.scoup", "--model", "scene/words.npz")
    assert record["levels"] == ["s", "m", "l"]
    assert record["gaussians"] == record["coded"] == 150
    query = run_json("query", "v2.scoup", "kettle", "--scene", "scene", "--out", "answers", "--always")
    assert query["answers"][0]["box"] is not None


def test_the_autoencoders_features_become_embeddings():
    network = LangSplatAutoencoder([8, 3], [8, 16], dim=16).eval()
    torch.save(network.state_dict(), "best_ckpt.pth")
    small = Path("scene/language_features").rename("small")
    for path in small.glob("*_f.npy"):
        with torch.no_grad():
            np.save(path, network.encode(torch.from_numpy(np.load(path))).numpy())
    said = "the regions have 3 numbers each, codes of LangSplat's autoencoder"
    assert said in refused(*BUILD, "--features", small)
    assert warned("info", small).startswith(f"warning: {said}")
    run_json("convert", small, "decoded", "--autoencoder", "best_ckpt.pth", "--bits", "32")
    assert run_json("info", "decoded")["dim"] == 16
    found, codes = load_regions("decoded", load_cameras("scene")), np.load(small / "view_00_f.npy")
    with torch.no_grad():
        wanted = network.decode(torch.from_numpy(codes)).numpy()
    rows = np.concatenate([found.load("view_00.png", level).embeddings.numpy() for level in found.levels])
    np.testing.assert_allclose(rows, wanted[-len(rows) :], atol=1e-5)


def test_langsplats_files_become_compact():
    record = run_json("convert", "scene", "compact", "--bits", "32", "--model", "my/model")
    assert record["bytes_after"] < record["bytes_before"]
    info = run_json("info", "compact")
    assert (info["kind"], info["views"], info["embedding_model"]) == ("region features", 4, "my/model")
    assert run_json("convert", "compact", "half")["bytes_after"] < record["bytes_after"]


# ---- words


def test_a_table_answers_as_its_model():
    """A tiny random one."""
    save_text_clip(Path("clip"))
    Path("list.txt").write_text("red apple\n\nobject\nchair\nred apple\n")
    said = run_json("words", "--model", "clip", "--words", "list.txt")
    names = (*CANONICAL_PHRASES, "red apple", "chair", *(word for word in EVERYDAY_WORDS if word != "chair"))
    assert said == {"out": "words.npz", "names": len(names), "dim": 12, "embedding_model": "clip"}
    assert WordTable.load("words.npz").names == names
    table, model = TextEncoder.open("words.npz"), TextEncoder.open("clip")
    asked = ["red apple", "chair", "the lamps"]
    assert (table.encode(asked) * model.encode(["red apple", "chair", "lamp"])).sum(1).min() > 1 - 1e-6
    assert (table.canonical() * model.canonical()).sum(1).min() > 1 - 1e-6
    assert table.everyday().shape[0] >= len(EVERYDAY_WORDS)
