"""Everyday words, their cache, word tables of every form, whole and damaged, and the text encoder over them."""

from __future__ import annotations

import json
import os
import shutil
import sys
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from messages import refuses
from scoup.base import (
    FileFormatError,
    MissingFileError,
    OutputExistsError,
    ScoupError,
    ScoupWarning,
    UnknownNameError,
    write_npz,
)
from scoup.models import text, word_cache
from scoup.models.hub import ModelIdentity, file_states
from scoup.models.text import TextEncoder
from scoup.models.word_cache import PROBE, cache_folder
from scoup.models.word_table import WordTable
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, LEAST_WORDS, with_everyday
from support import unit
from tiny_models import save_text_clip

NAMES = ["apple", "Dark Cup", "chair"]
VECTORS = np.array([[3.0, 0, 4], [0, 2, 0], [1, 1, 1]], dtype=np.float32)
UNIT = unit(torch.from_numpy(VECTORS))
BY_NAME = dict(zip(NAMES, VECTORS, strict=True))
FORMS: dict[str, Callable[[Path], object]] = {
    "npz-pair": lambda path: np.savez(path, names=NAMES, vectors=VECTORS),
    "npz-compressed": lambda path: np.savez_compressed(path, names=NAMES, vectors=VECTORS.astype(">f8")),
    "npz-names": lambda path: np.savez(path, **BY_NAME),
    "json": lambda path: path.write_text(json.dumps({name: row.tolist() for name, row in BY_NAME.items()})),
    "safetensors-pair": lambda path: save_file(
        {"vectors": torch.tensor(VECTORS).half()}, path, {"names": json.dumps(NAMES)}
    ),
    "safetensors-names": lambda path: save_file(
        {name: torch.from_numpy(row) for name, row in BY_NAME.items()}, path
    ),
}


@pytest.mark.parametrize("form", FORMS)
def test_tables_of_every_form(tmp_path: Path, form: str) -> None:
    path = tmp_path / f"words.{form.split('-')[0]}"
    FORMS[form](path)
    with TextEncoder.open(path) as encoder:
        assert (encoder.dim, encoder.name) == (3, "")
        vectors = encoder.encode(["chair", "apple", "Dark Cup", "chair"])
        assert vectors.dtype == torch.float32
        torch.testing.assert_close(vectors, UNIT[[2, 0, 1, 2]], atol=1e-6, rtol=0)
        torch.testing.assert_close(encoder.encode([" dark cup"]), UNIT[[1]])
        torch.testing.assert_close(encoder.encode(["the Dark Cups"]), UNIT[[1]])
        assert encoder.encode([]).shape == (0, 3)
    with refuses():
        encoder.encode(["apple"])
    encoder = TextEncoder.open({"Apple": [1, 0], "apple": [0, 1]})  # exact case goes before folded
    assert encoder.encode(["apple", "Apple", "APPLE"]).tolist() == [[0, 1], [1, 0], [1, 0]]


def test_missing_word_lists_the_nearest_names_and_the_file(tmp_path: Path) -> None:
    FORMS["npz-pair"](tmp_path / "words.npz")
    encoder = TextEncoder.open(tmp_path / "words.npz")
    with refuses(UnknownNameError):
        encoder.encode(["chair", "appel"])
    for model in ("some/model", "a demo (simulated)"):  # only the first can be used instead
        WordTable.save(tmp_path / "named.npz", NAMES, VECTORS, model=model, overwrite=True)
        with refuses(UnknownNameError):
            TextEncoder.open(tmp_path / "named.npz").encode(["appel"])
    # Long texts are not repeated.
    for phrases in ("apple", [" "], ["\udcff"], [NAMES[0], "ab" * 1_000_000]):
        with refuses():
            encoder.encode(phrases)
    with pytest.raises(UnknownNameError) as unknown:
        encoder.encode(["m" * 1000])
    assert len(str(unknown.value)) < 400 + len(str(tmp_path))


def test_save_table(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "words.npz"
    WordTable.save(path, NAMES, torch.from_numpy(VECTORS), model="some/model")
    encoder = TextEncoder.open(path)
    assert encoder.name == "some/model"
    torch.testing.assert_close(encoder.encode(NAMES), UNIT)
    loaded = np.load(path, allow_pickle=False)  # readable without this package
    assert loaded["names"].tolist() == NAMES
    before = path.read_bytes()
    with pytest.raises(OutputExistsError):
        WordTable.save(path, ["x"], [[1.0]])
    wrong = ((["a"], [[0.0, 0.0]]), (["a", "b"], [[1.0]]), (["a", "a"], [[1.0], [1.0]]), ([], []))
    for names, vectors in wrong:
        with refuses():
            WordTable.save(path, names, vectors, overwrite=True)
    assert path.read_bytes() == before
    WordTable.save(path, NAMES, VECTORS, overwrite=True, model="some/model")
    assert path.read_bytes() == before
    with refuses():
        WordTable.save(tmp_path / "words.json", NAMES, VECTORS)


def test_absent_tables_and_those_that_are_no_tables(tmp_path: Path) -> None:
    for name in ("absent.npz", "absent.JSON", "absent.safetensors"):
        with refuses(MissingFileError):
            TextEncoder.open(tmp_path / name)
    for name in ("a.npz", "a.json", "a.safetensors"):
        for content in (b"", b"nonsense", b"PK\x03\x04", b"[1, 2]", b'{"a": "b"}', b'{"a": [1, "b"]}', b"{}"):
            (tmp_path / name).write_bytes(content)
            with pytest.raises(FileFormatError, match=r"a\."):  # and what libraries say
                TextEncoder.open(tmp_path / name)


BAD: list[dict[str, np.ndarray]] = [
    {"names": np.array(NAMES), "vectors": VECTORS[:2]}, {"names": np.array(NAMES), "vectors": VECTORS[0]},
    {"names": np.array([1, 2, 3]), "vectors": VECTORS}, {"names": np.array(NAMES), "vectors": np.array(NAMES)},
    {"names": np.array(NAMES), "vectors": np.full((3, 3), np.nan)},
    {"names": np.array(NAMES), "vectors": np.zeros((3, 3))}, {"names": np.array(NAMES), "vectors": np.zeros((3, 0))},
    {"names": np.array(NAMES, dtype=object), "vectors": VECTORS},
    {"a": np.ones(2), "b": np.ones(3)}, {"a": np.ones((2, 2))}, {"a": np.array(3, np.float32)}, {},
]  # fmt: skip


def test_bad_arrays(tmp_path: Path) -> None:
    for arrays in BAD:
        np.savez(tmp_path / "bad.npz", **arrays)  # pyright: ignore
        with refuses(FileFormatError):
            WordTable.load(tmp_path / "bad.npz")


def test_a_claim_of_endless_data_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387904, 8), }".ljust(117) + "\n"
    member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("vectors.npy", member)
        archive.writestr("names.npy", member)
    large = tmp_path / "large.npz"
    np.savez_compressed(large, names=["a", "b"], vectors=np.ones((2, 3_000_000), "f4"))
    for endless in (path, large):
        with refuses(FileFormatError):
            WordTable.load(endless)


def test_everyday_words_of_a_table_are_its_other_names() -> None:
    names = ("red apple", "Object", "chair", "things", "stuff", "texture")
    encoder = TextEncoder.open(dict(zip(names, np.eye(6), strict=True)))
    assert encoder.names == names
    assert torch.equal(encoder.everyday(), encoder.encode(["red apple", "chair"]))
    assert torch.equal(encoder.canonical(), encoder.encode(["object", "things", "stuff", "texture"]))
    assert torch.equal(encoder.canonical(everyday=True), encoder.canonical())  # two words are too few


def test_words_of_a_table_can_be_asked_whatever_blanks_its_names_have() -> None:
    names = (*CANONICAL_PHRASES, "red  apple", "a\u2028chair", " lamp\t", "\n")
    encoder = TextEncoder.open(dict(zip(names, np.eye(8), strict=True)))
    assert encoder.vocabulary() == ("red apple", "a chair", "lamp")
    assert torch.equal(encoder.encode(encoder.vocabulary()), torch.eye(8)[4:7])
    assert torch.equal(encoder.encode(["Red \n apples", "the  lamp"]), torch.eye(8)[[4, 6]])


def test_a_dict_is_an_encoder() -> None:
    vectors = torch.randn(5, 6, generator=torch.Generator().manual_seed(0))
    names = ["object", "things", "stuff", "texture", "red apple"]
    for rows in (vectors, 7 * vectors.double().numpy(), vectors.tolist()):
        encoder = TextEncoder.open(dict(zip(names, rows, strict=True)))
        assert (encoder.names, encoder.dim, encoder.name) == (tuple(names), 6, "")
        torch.testing.assert_close(encoder.encode(["Red Apple", "stuff"]), unit(vectors[[4, 2]]))
    with refuses(UnknownNameError):
        encoder.encode(["red aple"])
    encoder.close()
    with refuses():
        encoder.canonical()
    ones, table = torch.ones(3), {"a": torch.ones(3), "b": torch.ones(4)}
    for vectors in ({}, table, {"a": torch.ones(2, 2)}, {"a": 0 * ones}, {"a": torch.nan * ones}, {3: ones}):
        with refuses():
            TextEncoder.open(vectors)  # pyright: ignore[reportArgumentType]


def test_everyday_words() -> None:
    assert 950 <= len({word.casefold() for word in EVERYDAY_WORDS}) == len(EVERYDAY_WORDS) <= 1100
    assert CANONICAL_PHRASES == ("object", "things", "stuff", "texture")  # the papers'
    assert not set(EVERYDAY_WORDS) & set(CANONICAL_PHRASES)
    for word in EVERYDAY_WORDS:
        assert word == " ".join(word.split())
        assert 1 <= len(word.split()) <= 2, word
    canonical, words = (unit(torch.randn(count, 16)) for count in (4, LEAST_WORDS))
    torch.testing.assert_close(with_everyday(canonical, words), torch.cat([canonical, words.mean(0)[None]]))
    assert with_everyday(canonical, words[1:]) is canonical


MODEL = ModelIdentity("a/model", "c0ffee", "package 1")
FEW = ("apple", "chair", "kettle")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SCOUP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "words"


def test_a_model_encodes_words_once(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[str] = []  # phrases, but for the one that every opening encodes
    open_model, folder = text.open_text_model, save_text_clip(tmp_path / "clip")

    def opened(*arguments: Any) -> tuple[text.Encode, ModelIdentity]:
        encode, identity = open_model(*arguments)

        def encode_counted(batch: list[str]) -> Tensor:
            counted.extend(phrase for phrase in batch if phrase != PROBE)
            return encode(batch)

        return encode_counted, identity

    monkeypatch.setattr(text, "open_text_model", opened)
    first = TextEncoder.open(folder).everyday()
    assert counted == list(EVERYDAY_WORDS)
    torch.testing.assert_close(first.norm(dim=1), torch.ones(len(first)))
    (path,) = cache.iterdir()
    written = path.read_bytes()
    encoder = TextEncoder.open(folder)
    assert encoder.everyday().equal(first)
    assert encoder.encode(list(EVERYDAY_WORDS)).equal(first)  # as a page asks for its vocabulary
    assert (len(counted), path.read_bytes()) == (len(EVERYDAY_WORDS), written)
    # Other weights, even if all that the file system says is as before, which it rarely is.
    before = (folder / "model.safetensors").stat()
    save_text_clip(folder, seed=1)
    os.utime(folder / "model.safetensors", ns=(before.st_atime_ns, before.st_mtime_ns))
    counted.clear()
    assert not TextEncoder.open(folder).everyday().allclose(first, atol=0.01)
    assert counted == list(EVERYDAY_WORDS)


def ask(
    model: ModelIdentity = MODEL, words: Sequence[str] = FEW, seed: int = 0, nan_row: int | None = None
) -> tuple[Tensor, list[int]]:
    """Vectors of words, and how many each call of the encoder was asked for."""
    vectors = unit(torch.randn(1 + len(FEW), 16, generator=torch.Generator().manual_seed(seed)))
    calls: list[int] = []
    if nan_row is not None:
        vectors[nan_row] = torch.nan

    def encode(asked: Sequence[str]) -> Tensor:
        calls.append(len(asked))
        return vectors[1 : 1 + len(asked)]

    return word_cache.cached_vectors(model, vectors[:1], words, encode), calls


def test_what_the_key_depends_on(cache: Path) -> None:
    assert ask(nan_row=2)[0].isnan().any(1).tolist() == [False, True, False]
    assert not cache.exists()  # vectors that are not finite are not kept
    ask()
    (path,) = cache.iterdir()
    assert path.name.startswith("a-model-c0ffee-")
    assert WordTable.load(path).names == (PROBE, *FEW)
    others: list[tuple[ModelIdentity, Sequence[str], int]] = [
        (replace(MODEL, name="a/another"), FEW, 0), (replace(MODEL, revision="0ff"), FEW, 0),
        (replace(MODEL, package="package 2"), FEW, 0), (replace(MODEL, files=("weights 3 4",)), FEW, 0),
        (MODEL, FEW[:2], 0), (MODEL, FEW, 1),  # other weights, of which nothing but the probe tells
    ]  # fmt: skip
    for model, words, seed in others:
        for calls in ([len(words)], []):
            assert ask(model, words, seed)[1] == calls


def test_a_damaged_file_is_replaced(cache: Path) -> None:
    expected, _ = ask()
    (path,) = cache.iterdir()
    written = path.read_bytes()
    with np.load(path) as table:
        names, vectors = table["names"], table["vectors"]
    place = written.index(vectors[2].tobytes())
    damages: dict[str, bytes | tuple[np.ndarray, np.ndarray]] = {  # contents, or names and vectors
        "cut": written[:-100],
        "a bit": written[:place] + bytes([written[place] ^ 1]) + written[place + 1 :],
        "wrong names": (names[::-1], vectors),
        "wrong dimension": (names, vectors[:, :-1]),
        "too few": (names[:-1], vectors[:-1]),
    }
    for kind, content in damages.items():
        if isinstance(content, bytes):
            path.write_bytes(content)
        else:
            write_npz(path, dict(zip(("names", "vectors"), content, strict=True)), overwrite=True)
        vectors, calls = ask()
        assert (len(calls), path.read_bytes()) == (1, written), kind
        assert vectors.equal(expected)


@pytest.mark.parametrize("kind", ["file", "folder", "read-only", "homeless"])
def test_without_a_cache_words_are_encoded(cache: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    expected, _ = ask()
    (path,) = cache.iterdir()
    shutil.rmtree(cache)
    {
        "file": lambda: cache.write_text(""),
        "folder": lambda: path.mkdir(parents=True),
        "read-only": lambda: monkeypatch.setattr(Path, "mkdir", Mock(side_effect=PermissionError)),
        "homeless": lambda: monkeypatch.setattr(word_cache, "cache_folder", lambda: None),
    }[kind]()
    for _ in range(2):
        vectors, calls = ask()
        assert len(calls) == 1
        assert vectors.equal(expected)


ASKED = ["red apple", "kettle", "my own chair", "red apple"]  # the second is an everyday word


@pytest.fixture
def clip_files(tmp_path: Path) -> Path:
    return save_text_clip(tmp_path / "clip")


def no_model(*arguments: Any) -> None:
    raise AssertionError(f"{arguments} opened")


def test_known_words_need_no_model(clip_files: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = TextEncoder.open(clip_files)
    asked, canonical, everyday = first.encode(ASKED), first.canonical(), first.everyday()
    assert asked[1].equal(everyday[EVERYDAY_WORDS.index("kettle")])
    many = first.encode([*ASKED, *(f"{name} apple" for name in range(word_cache.MOST_ALONE))])
    torch.testing.assert_close(many[:4], asked, atol=1e-6, rtol=1e-5)
    assert len([*cache.with_name("asked").glob("*/*")]) == 1 + 2 + len(CANONICAL_PHRASES)  # and the model
    with monkeypatch.context() as patch:
        patch.setattr(text, "open_text_model", no_model)
        patch.setitem(sys.modules, "transformers", None)
        encoder = TextEncoder.open(clip_files)
        assert (encoder.dim, encoder.name) == (first.dim, first.name)
        assert encoder.encode(ASKED).equal(asked)
        assert encoder.encode(EVERYDAY_WORDS).equal(everyday)
        assert encoder.canonical().equal(canonical)
        with pytest.raises(AssertionError, match="opened"):
            encoder.encode(["red kettle"])
    # The same bytes with some, all or none of them in the cache.
    shutil.rmtree(cache.with_name("asked"))
    TextEncoder.open(clip_files).encode(["my own chair"])
    assert TextEncoder.open(clip_files).encode(ASKED).equal(asked)
    monkeypatch.setattr(word_cache, "cache_folder", lambda: None)
    assert TextEncoder.open(clip_files).encode(ASKED).equal(asked)


def test_long_phrases_and_old_words_are_not_kept(
    clip_files: Path, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for _ in range(2):  # the second warns as the first
        with pytest.warns(ScoupWarning, match="tokens"):
            TextEncoder.open(clip_files).encode(["red apple chair object " * 3])
    monkeypatch.setattr(word_cache, "_MOST_FILES", 3)
    TextEncoder.open(clip_files).encode([f"apple {number}" for number in range(5)])
    TextEncoder.open(clip_files).encode(["red chair"])
    (path,) = (
        path for path in cache.with_name("asked").rglob("*.npz") if WordTable.load(path).names == (PROBE,)
    )
    path.write_bytes(b"")
    TextEncoder.open(clip_files)
    assert len([*path.parent.iterdir()]) == 3
    assert WordTable.load(path).names == (PROBE,)


def test_damaged_and_foreign_files_of_asked_words(clip_files: Path, tmp_path: Path, cache: Path) -> None:
    folders, phrases = (clip_files, save_text_clip(tmp_path / "other", seed=1)), ["red apple", "red chair"]
    files: list[dict[tuple[str, ...], Path]] = []
    for folder in folders:
        before = {*cache.with_name("asked").rglob("*.npz")}
        TextEncoder.open(folder).encode(phrases)
        new = {*cache.with_name("asked").rglob("*.npz")} - before
        files.append({WordTable.load(path).names: path for path in new})
    first, second = files
    assert first.keys() == second.keys() == {(PROBE,), (PROBE, "red apple"), (PROBE, "red chair")}
    expected = TextEncoder.open(clip_files).encode(phrases)
    apple = (PROBE, "red apple")
    for names, foreign in [*((names, second[names]) for names in first), (apple, first[PROBE, "red chair"])]:
        shutil.copyfile(foreign, first[names])
        assert TextEncoder.open(clip_files).encode(phrases).equal(expected), names
    shutil.copyfile(first[apple], first[PROBE,])  # a word's file in place of the model's
    assert TextEncoder.open(clip_files).encode(phrases).equal(expected)
    for path in (first[PROBE,], first[apple]):
        written = path.read_bytes()
        for place in range(0, len(written), 211):
            path.write_bytes(written[:place] + bytes([written[place] ^ 4]) + written[place + 1 :])
            assert TextEncoder.open(clip_files).encode(phrases).equal(expected), (path, place)


def test_a_model_that_changes_while_it_is_in_use(clip_files: Path) -> None:
    TextEncoder.open(clip_files).encode(["red apple"])
    with TextEncoder.open(clip_files) as encoder:
        before = encoder.encode(["red apple"])
        save_text_clip(clip_files, seed=1)
        for _ in range(2):
            with refuses(ScoupError):
                encoder.encode(["red chair"])
    assert not TextEncoder.open(clip_files).encode(["red apple"]).allclose(before, atol=0.01)


def test_a_name_that_opens_the_same_model(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    versions = {"transformers": "5", "open_clip_torch": "2"}
    monkeypatch.setattr("importlib.metadata.version", versions.__getitem__)
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_CACHE", str(tmp_path))
    of_hub = ModelIdentity("a/model", "c0ffee", "transformers 5")
    assert of_hub.is_current("a/model", None)  # nothing is known of it here
    refs = tmp_path / "models--a--model" / "refs"
    refs.mkdir(parents=True)
    for name, commit in (("main", "c0ffee"), ("new", "0ff")):
        (refs / name).write_text(f"{commit}\n")
    assert of_hub.is_current("a/model", None)
    assert of_hub.is_current("a/model", "c0ffee")
    assert not of_hub.is_current("a/model", "new")
    assert not replace(of_hub, revision="").is_current("a/model", None)
    assert not replace(of_hub, package="transformers 4").is_current("a/model", None)
    assert not replace(of_hub, package="another 5").is_current("a/model", None)
    (weights := tmp_path / "weights.pt").write_text("123")
    for name, identity in (
        (
            f"open_clip:ViT-B-16/{weights}",
            ModelIdentity("open_clip:ViT-B-16", "", "open_clip 2", file_states(str(weights))),
        ),
        (str(refs), ModelIdentity("refs", "", "transformers 5", file_states(str(refs)))),
    ):
        assert identity.is_current(name, None)
        assert not replace(identity, files=()).is_current(name, None)
    assert ModelIdentity("open_clip:ViT-B-16/tag", "", "open_clip 2").is_current(
        "open_clip:ViT-B-16/tag", None
    )


def test_files_of_a_model(tmp_path: Path) -> None:
    assert file_states(str(tmp_path / "laion2b")) == ()
    (tmp_path / "weights").write_text("123")
    os.utime(tmp_path / "weights", ns=(0, 5))
    (tmp_path / "inner").mkdir()
    changed = os.stat(tmp_path / "weights").st_ctime_ns
    state = f"{os.path.realpath(tmp_path / 'weights')} 3 5 {changed}"
    assert file_states(str(tmp_path)) == file_states(str(tmp_path / "weights")) == (state,)


@pytest.mark.parametrize(("platform", "variables", "expected"), [
    ("linux", {}, "home/.cache/scoup"),
    ("linux", {"XDG_CACHE_HOME": "/xdg"}, "/xdg/scoup"),
    ("linux", {"XDG_CACHE_HOME": "relative"}, "home/.cache/scoup"),
    ("darwin", {"XDG_CACHE_HOME": "/xdg"}, "home/Library/Caches/scoup"),
    ("win32", {}, "home/AppData/Local/scoup"),
    ("win32", {"LOCALAPPDATA": "/local"}, "/local/scoup"),
    ("win32", {"SCOUP_CACHE": "/own", "LOCALAPPDATA": "/local"}, "/own"),
    ("linux", {"SCOUP_CACHE": "own", "XDG_CACHE_HOME": "/xdg"}, "own"),
    ("linux", None, None),  # a user without a home
])  # fmt: skip
@pytest.mark.skipif(sys.platform == "win32", reason="these paths are not absolute there")
def test_the_folder_of_the_cache(
    monkeypatch: pytest.MonkeyPatch, platform: str, variables: dict[str, str] | None, expected: str | None
) -> None:
    for name in ("SCOUP_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.delenv(name, raising=False)
    for name, value in (variables or {}).items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "platform", platform)
    home = RuntimeError("no home") if variables is None else [Path("home")]
    monkeypatch.setattr(Path, "home", Mock(side_effect=home))
    assert cache_folder() == (None if expected is None else Path(expected))
