"""Text encoders: tables of every form, damaged tables, and tiny random CLIP kinds, all offline."""

from __future__ import annotations

import json
import os
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from scoup.base.errors import (
    FileFormatError,
    InputError,
    MissingFileError,
    OutputExistsError,
    ScoupError,
    ScoupWarning,
    UnknownNameError,
)
from scoup.models.text import TextEncoder, save_table
from scoup.models.word_table import load_table

os.environ["HF_HUB_OFFLINE"] = "1"

NAMES = ["apple", "Dark Cup", "chair"]
VECTORS = np.array([[3.0, 0, 4], [0, 2, 0], [1, 1, 1]], dtype=np.float32)
UNIT = torch.nn.functional.normalize(torch.from_numpy(VECTORS), dim=1)


def write_table(path: Path, form: str) -> Path:
    if form == "npz-pair":
        np.savez(path, names=np.array(NAMES), vectors=VECTORS)
    elif form == "npz-compressed":
        np.savez_compressed(path, names=np.array(NAMES), vectors=VECTORS.astype(">f8"))
    elif form == "npz-names":
        np.savez(path, **dict(zip(NAMES, VECTORS, strict=True)))
    elif form == "json":
        path.write_text(json.dumps({name: row.tolist() for name, row in zip(NAMES, VECTORS, strict=True)}))
    else:
        from safetensors.torch import save_file

        vectors = torch.from_numpy(VECTORS)
        if form == "safetensors-pair":
            save_file({"vectors": vectors.half()}, path, metadata={"names": json.dumps(NAMES)})
        else:
            save_file({name: row.clone() for name, row in zip(NAMES, vectors, strict=True)}, path)
    return path


FORMS = ["npz-pair", "npz-compressed", "npz-names", "json", "safetensors-pair", "safetensors-names"]


@pytest.mark.parametrize("form", FORMS)
def test_tables_of_every_form(tmp_path: Path, form: str) -> None:
    path = write_table(tmp_path / f"words.{form.split('-')[0]}", form)
    with TextEncoder.open(path) as encoder:
        assert (encoder.dim, encoder.name) == (3, "")
        vectors = encoder.encode(["chair", "apple", "Dark Cup", "chair"])
        assert vectors.dtype == torch.float32
        torch.testing.assert_close(vectors, UNIT[[2, 0, 1, 2]], atol=1e-6, rtol=0)
        torch.testing.assert_close(encoder.encode([" dark cup"]), UNIT[[1]])
        assert encoder.encode([]).shape == (0, 3)
    with pytest.raises(InputError, match="closed"):
        encoder.encode(["apple"])


def test_exact_case_goes_before_folded(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_text(json.dumps({"Apple": [1, 0], "apple": [0, 1]}))
    encoder = TextEncoder.open(path)
    assert encoder.encode(["apple", "Apple", "APPLE"]).tolist() == [[0, 1], [1, 0], [1, 0]]


def test_missing_word_lists_the_nearest_names_and_the_file(tmp_path: Path) -> None:
    encoder = TextEncoder.open(write_table(tmp_path / "words.npz", "npz-pair"))
    with pytest.raises(
        UnknownNameError, match=r"words\.npz: no text embedding named 'appel'; nearest names: 'apple'"
    ):
        encoder.encode(["chair", "appel"])
    with pytest.raises(InputError, match="list of phrases"):
        encoder.encode("apple")
    with pytest.raises(InputError, match="blank"):
        encoder.encode([" "])


def test_save_table(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "words.npz"
    save_table(path, NAMES, torch.from_numpy(VECTORS), model="some/model")
    encoder = TextEncoder.open(path)
    assert encoder.name == "some/model"
    torch.testing.assert_close(encoder.encode(NAMES), UNIT)
    loaded = np.load(path, allow_pickle=False)  # readable without this package
    assert loaded["names"].tolist() == NAMES
    before = path.read_bytes()
    with pytest.raises(OutputExistsError):
        save_table(path, ["x"], [[1.0]])
    for names, vectors in (
        (["a"], [[0.0, 0.0]]),
        (["a", "b"], [[1.0]]),
        (["a", "a"], [[1.0], [1.0]]),
        ([], []),
    ):
        with pytest.raises(InputError):
            save_table(path, names, vectors, overwrite=True)
    assert path.read_bytes() == before
    save_table(path, NAMES, VECTORS, overwrite=True, model="some/model")
    assert path.read_bytes() == before
    with pytest.raises(InputError, match="npz"):
        save_table(tmp_path / "words.json", NAMES, VECTORS)


def test_absent_tables_and_those_that_are_no_tables(tmp_path: Path) -> None:
    for name in ("absent.npz", "absent.JSON", "absent.safetensors"):
        with pytest.raises(MissingFileError, match="absent"):
            TextEncoder.open(tmp_path / name)
    for name in ("a.npz", "a.json", "a.safetensors"):
        for content in (b"", b"nonsense", b"PK\x03\x04", b"[1, 2]", b'{"a": "b"}', b'{"a": [1, "b"]}', b"{}"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(FileFormatError, match=r"a\."):
                TextEncoder.open(tmp_path / name)


@pytest.mark.parametrize(
    "arrays",
    [
        {"names": np.array(NAMES), "vectors": VECTORS[:2]},
        {"names": np.array(NAMES), "vectors": VECTORS[0]},
        {"names": np.array([1, 2, 3]), "vectors": VECTORS},
        {"names": np.array(NAMES), "vectors": np.array(NAMES)},
        {"names": np.array(NAMES), "vectors": np.full((3, 3), np.nan)},
        {"names": np.array(NAMES), "vectors": np.zeros((3, 3))},
        {"names": np.array(NAMES), "vectors": np.zeros((3, 0))},
        {"names": np.array(NAMES, dtype=object), "vectors": VECTORS},
        {"a": np.ones(2), "b": np.ones(3)},
        {"a": np.ones((2, 2))},
        {"a": np.float32(3)},
        {},
    ],
)
def test_bad_arrays(tmp_path: Path, arrays: dict[str, np.ndarray]) -> None:
    path = tmp_path / "bad.npz"
    np.savez(path, **arrays)  # pyright: ignore
    with pytest.raises(FileFormatError, match=r"bad\.npz"):
        load_table(path)


def test_a_claim_of_endless_data_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387904, 8), }"
    header = header.ljust(117) + "\n"
    member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("vectors.npy", member)
        archive.writestr("names.npy", member)
    with pytest.raises(FileFormatError, match="cut short"):
        load_table(path)


@settings(max_examples=120, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow])
@given(st.sampled_from(FORMS), st.data())
def test_damaged_tables_never_crash(tmp_path: Path, form: str, data: st.DataObject) -> None:
    path = tmp_path / f"damaged.{form.split('-')[0]}"
    path.unlink(missing_ok=True)
    raw = bytearray(write_table(path, form).read_bytes())
    for _ in range(data.draw(st.integers(0, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        raw = raw[: data.draw(st.integers(0, len(raw)))]
    path.write_bytes(bytes(raw))
    try:
        table = load_table(path)
    except FileFormatError:
        return
    assert table.vectors.shape[0] == len(table.names)
    assert np.isfinite(table.vectors).all()


@pytest.mark.data
def test_real_clip_table(data_folder: Path) -> None:
    path = data_folder / "clip" / "text_vit_b16_laion2b.npz"
    if not path.is_file():
        pytest.skip(f"no text vectors at {path}")
    encoder = TextEncoder.open(path)
    vectors = encoder.encode(["object", "things", "stuff", "texture", "STAINLESS steel pots"])
    assert vectors.shape == (5, 512)
    torch.testing.assert_close(torch.linalg.vector_norm(vectors, dim=1), torch.ones(5))


# ---- models, tiny and random


def tiny_tokenizer(folder: Path, words: list[str]) -> None:
    from tokenizers import Tokenizer
    from tokenizers.models import WordLevel
    from tokenizers.pre_tokenizers import Whitespace
    from tokenizers.processors import TemplateProcessing
    from transformers import PreTrainedTokenizerFast

    vocabulary = {word: index for index, word in enumerate(["<unk>", "<bos>", *words, "<eos>"])}
    tokenizer = Tokenizer(WordLevel(vocabulary, unk_token="<unk>"))
    tokenizer.pre_tokenizer = Whitespace()  # pyright: ignore
    tokenizer.post_processor = TemplateProcessing(  # pyright: ignore
        single="<bos> $A <eos>", special_tokens=[(name, vocabulary[name]) for name in ("<bos>", "<eos>")]
    )
    PreTrainedTokenizerFast(
        tokenizer_object=tokenizer, bos_token="<bos>", eos_token="<eos>", pad_token="<eos>", unk_token="<unk>"
    ).save_pretrained(folder)


WORDS = ["object", "red", "apple", "chair"]
TINY = {
    "hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 2, "num_attention_heads": 2,
    "vocab_size": 7, "max_position_embeddings": 8, "bos_token_id": 1, "eos_token_id": 6, "pad_token_id": 6,
}  # fmt: skip


@pytest.fixture(scope="module")
def clip_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    transformers = pytest.importorskip("transformers")
    folder = tmp_path_factory.mktemp("clip")
    vision = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2,
              "image_size": 8, "patch_size": 4}  # fmt: skip
    torch.manual_seed(0)
    config = transformers.CLIPConfig(text_config=TINY, vision_config=vision, projection_dim=12)
    transformers.CLIPModel(config).save_pretrained(folder)
    tiny_tokenizer(folder, WORDS)
    return folder


def test_clip_through_transformers(clip_folder: Path) -> None:
    import transformers

    encoder = TextEncoder.open(clip_folder)
    assert (encoder.dim, encoder.name) == (12, str(clip_folder))
    vectors = encoder.encode(["red apple", "chair"])
    assert vectors.dtype == torch.float32
    torch.testing.assert_close(torch.linalg.vector_norm(vectors, dim=1), torch.ones(2))
    # Alone and without padding the answer is the same.
    model = transformers.CLIPModel.from_pretrained(clip_folder).eval()
    with torch.inference_mode():
        features = model.get_text_features(input_ids=torch.tensor([[1, 3, 4, 6]]))
    expected: Any = getattr(features, "pooler_output", features)
    torch.testing.assert_close(
        vectors[:1], torch.nn.functional.normalize(expected, dim=1), atol=1e-5, rtol=1e-4
    )
    torch.testing.assert_close(encoder.encode(["chair"]), vectors[1:], atol=1e-6, rtol=1e-5)
    many = encoder.encode(["red apple", "chair"] * 40)
    torch.testing.assert_close(many, vectors.repeat(40, 1), atol=1e-6, rtol=1e-5)
    with pytest.warns(ScoupWarning, match="tokens"):
        encoder.encode(["red apple chair object red apple chair object"])


def test_siglip_through_transformers(tmp_path: Path) -> None:
    transformers = pytest.importorskip("transformers")
    text = {**TINY, "projection_size": 16}
    vision = {"hidden_size": 16, "intermediate_size": 32, "num_hidden_layers": 1, "num_attention_heads": 2,
              "image_size": 8, "patch_size": 4}  # fmt: skip
    torch.manual_seed(0)
    transformers.SiglipModel(
        transformers.SiglipConfig(text_config=text, vision_config=vision)
    ).save_pretrained(tmp_path)
    tiny_tokenizer(tmp_path, WORDS)
    encoder = TextEncoder.open(str(tmp_path))
    assert encoder.dim == 16
    model = transformers.SiglipModel.from_pretrained(tmp_path).eval()
    with torch.inference_mode():
        features = model.get_text_features(input_ids=torch.tensor([[1, 4, 6, 6, 6, 6, 6, 6]]))
    expected = torch.nn.functional.normalize(getattr(features, "pooler_output", features), dim=1)
    torch.testing.assert_close(encoder.encode(["apple"]), expected, atol=1e-6, rtol=1e-5)


def test_models_that_cannot_be_loaded(clip_folder: Path, tmp_path: Path) -> None:
    import shutil

    for model in ("nobody/has-this-model", str(tmp_path), "not a model id", "a/b/c"):
        with pytest.raises(ScoupError, match="table file"):
            TextEncoder.open(model)
    broken = tmp_path / "broken"
    shutil.copytree(clip_folder, broken)
    weights = broken / "model.safetensors"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(ScoupError, match="cannot be loaded"):
        TextEncoder.open(broken)
    weights.unlink()
    with pytest.raises(ScoupError, match="cannot be loaded"):
        TextEncoder.open(broken)


def test_incomplete_weights_are_not_made_up(clip_folder: Path, tmp_path: Path) -> None:
    import shutil

    from safetensors.torch import load_file, save_file

    folder = tmp_path / "partial"
    shutil.copytree(clip_folder, folder)
    tensors = load_file(folder / "model.safetensors")
    del tensors["text_projection.weight"]
    save_file(tensors, folder / "model.safetensors", metadata={"format": "pt"})
    with pytest.raises(ScoupError, match="lacks weights"):
        TextEncoder.open(folder)


def test_other_kinds_of_model_are_refused(tmp_path: Path) -> None:
    transformers = pytest.importorskip("transformers")
    config = transformers.BertConfig(hidden_size=16, num_hidden_layers=1, num_attention_heads=2, vocab_size=7,
                                     intermediate_size=16)  # fmt: skip
    transformers.BertModel(config).save_pretrained(tmp_path)
    tiny_tokenizer(tmp_path, WORDS)
    with pytest.raises(ScoupError, match="no text features"):
        TextEncoder.open(tmp_path)


@pytest.mark.parametrize(
    ("model", "package", "remedy"),
    [
        ("laion/CLIP-ViT-B-16-laion2B-s34B-b88K", "transformers", r"scoup\[models\]"),
        ("open_clip:ViT-B-16/laion2b_s34b_b88k", "open_clip", r"scoup\[open-clip\]"),
    ],
)
def test_absent_packages(monkeypatch: pytest.MonkeyPatch, model: str, package: str, remedy: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(ScoupError, match=remedy):
        TextEncoder.open(model)


def test_open_clip(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a stand-in for the package, which is optional: what is asked of it, and what is made of its
    answer.
    """
    from types import SimpleNamespace

    class Model(torch.nn.Module):
        def encode_text(self, tokens: torch.Tensor) -> torch.Tensor:
            return tokens.float() * 2

    def create_model(architecture: str, pretrained: str, device: str) -> Model:
        if (architecture, pretrained) != ("ViT-B-16", "laion2b_s34b_b88k"):
            raise RuntimeError("Model config for X not found.")
        return Model()

    def get_tokenizer(architecture: str):
        return lambda phrases: torch.tensor([[len(phrase), 3, 4] for phrase in phrases])

    stand_in = SimpleNamespace(create_model=create_model, get_tokenizer=get_tokenizer)
    monkeypatch.setitem(sys.modules, "open_clip", stand_in)
    encoder = TextEncoder.open("open_clip:ViT-B-16/laion2b_s34b_b88k")
    assert encoder.dim == 3
    expected = torch.nn.functional.normalize(torch.tensor([[5.0, 3, 4]]), dim=1)
    torch.testing.assert_close(encoder.encode(["apple"]), expected)
    with pytest.raises(ScoupError, match="not found"):
        TextEncoder.open("open_clip:X/y")
    with pytest.raises(InputError, match="ARCHITECTURE"):
        TextEncoder.open("open_clip:ViT-B-16")


def test_everyday_words_of_a_table_are_its_other_names(tmp_path: Path) -> None:
    names = ["red apple", "Object", "chair", "things", "stuff", "texture"]
    vectors = np.random.default_rng(0).normal(size=(6, 5)).astype(np.float32)
    save_table(tmp_path / "words.npz", names, vectors)
    encoder = TextEncoder.open(tmp_path / "words.npz")
    assert encoder.table_names == tuple(names)
    assert torch.equal(encoder.everyday(), encoder.encode(["red apple", "chair"]))
    assert torch.equal(encoder.canonical(), encoder.encode(["object", "things", "stuff", "texture"]))
    assert torch.equal(encoder.canonical(everyday=True), encoder.canonical())  # two words are too few


def test_everyday_words_of_a_model_are_a_fixed_list(clip_folder: Path) -> None:
    from scoup.models.words import EVERYDAY_WORDS

    encoder = TextEncoder.open(clip_folder)
    assert encoder.table_names is None
    assert encoder.everyday().shape == (len(EVERYDAY_WORDS), 12)
    both = encoder.canonical(everyday=True)
    assert torch.equal(both[:4], encoder.canonical())
    torch.testing.assert_close(both[4], encoder.encode(EVERYDAY_WORDS).mean(0))
