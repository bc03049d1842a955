"""Vectors of everyday words are encoded once per model, and read from a cache that is never trusted."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from children import workers
from scoup.base import write_npz
from scoup.models import text, word_cache
from scoup.models.hub import ModelIdentity, file_states
from scoup.models.text import TextEncoder
from scoup.models.word_table import load_table
from scoup.models.words import EVERYDAY_WORDS
from support import unit
from tiny_models import save_text_clip

MODEL = ModelIdentity("a/model", "c0ffee", "package 1")
NAMES = ("apple", "chair", "kettle")


@pytest.fixture(scope="module")
def saved_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_text_clip(tmp_path_factory.mktemp("clip"))


@pytest.fixture
def clip_folder(saved_clip: Path, tmp_path: Path) -> Path:
    return shutil.copytree(saved_clip, tmp_path / "clip")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SCOUP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "words"


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The phrases that models have encoded, but for the one that every opening encodes."""
    phrases: list[str] = []
    open_model = text.open_text_model

    def opened(*arguments: object) -> tuple[text.Encode, ModelIdentity]:
        encode, identity = open_model(*arguments)  # pyright: ignore[reportArgumentType]

        def encode_counted(batch: list[str]) -> Tensor:
            phrases.extend(phrase for phrase in batch if phrase != word_cache.PROBE)
            return encode(batch)

        return encode_counted, identity

    monkeypatch.setattr(text, "open_text_model", opened)
    return phrases


def opened_everyday(folder: Path) -> Tensor:
    with TextEncoder.open(folder) as encoder:
        return encoder.everyday()


def test_words_are_encoded_once(clip_folder: Path, cache: Path, counted: list[str]) -> None:
    first = opened_everyday(clip_folder)
    assert counted == list(EVERYDAY_WORDS)
    torch.testing.assert_close(first.norm(dim=1), torch.ones(len(first)))
    (path,) = cache.iterdir()
    assert path.name.startswith("clip-")
    written = path.read_bytes()
    with TextEncoder.open(clip_folder) as encoder:
        assert encoder.everyday().equal(first)
        assert encoder.encode(list(EVERYDAY_WORDS)).equal(first)  # as a page asks for its vocabulary
        assert len(counted) == len(EVERYDAY_WORDS)
        assert path.read_bytes() == written
        plain = encoder.encode(EVERYDAY_WORDS[:-1])  # not from the cache
        assert len(plain) == len(first) - 1 == len(counted) - len(first)
        torch.testing.assert_close(first[:-1], plain, atol=5e-4, rtol=0)
    shutil.rmtree(cache)
    assert opened_everyday(clip_folder).equal(first)
    assert path.read_bytes() == written


def test_a_changed_model_is_encoded_again(clip_folder: Path, cache: Path, counted: list[str]) -> None:
    first = opened_everyday(clip_folder)
    weights = clip_folder / "model.safetensors"
    before = weights.stat()
    save_text_clip(clip_folder, seed=1)
    # Even if all that the file system says is as before, which it rarely is.
    os.utime(weights, ns=(before.st_atime_ns, before.st_mtime_ns))
    second = opened_everyday(clip_folder)
    assert not second.allclose(first, atol=0.01)
    assert len(counted) == 2 * len(EVERYDAY_WORDS)
    os.utime(weights, ns=(0, 0))
    assert opened_everyday(clip_folder).equal(second)
    assert len(counted) == 3 * len(EVERYDAY_WORDS)


def encoder_of(vectors: Tensor, calls: list[int]) -> Callable[[Sequence[str]], Tensor]:
    def encode(words: Sequence[str]) -> Tensor:
        calls.append(len(words))
        return vectors[1 : 1 + len(words)]

    return encode


def random_vectors(seed: int = 0, dim: int = 16) -> Tensor:
    return unit(torch.randn(1 + len(NAMES), dim, generator=torch.Generator().manual_seed(seed)))


def ask(
    model: ModelIdentity = MODEL, words: Sequence[str] = NAMES, seed: int = 0
) -> tuple[Tensor, list[int]]:
    vectors, calls = random_vectors(seed), []
    return word_cache.everyday_vectors(model, vectors[:1], words, encoder_of(vectors, calls)), calls


@pytest.mark.parametrize(
    ("model", "words", "seed"),
    [
        (replace(MODEL, name="a/another"), NAMES, 0),
        (replace(MODEL, revision="0ff"), NAMES, 0),
        (replace(MODEL, package="package 2"), NAMES, 0),
        (replace(MODEL, files=("weights 3 4",)), NAMES, 0),
        (MODEL, NAMES[:2], 0),
        (MODEL, NAMES, 1),  # other weights, of which nothing else tells
    ],
)
def test_what_the_key_depends_on(cache: Path, model: ModelIdentity, words: Sequence[str], seed: int) -> None:
    ask()
    (path,) = cache.iterdir()
    assert path.name.startswith("a-model-c0ffee-")
    assert ask()[1] == []
    assert ask(model, words, seed)[1] == [len(words)]
    assert ask(model, words, seed)[1] == []


def damage(path: Path, kind: str) -> None:
    content = path.read_bytes()
    names = np.array([word_cache.PROBE, *NAMES])
    vectors = random_vectors().half().numpy()
    infinite = vectors.copy()
    infinite[2, 3] = np.inf
    arrays = {
        "wrong names": {"names": names[::-1], "vectors": vectors},
        "wrong dimension": {"names": names, "vectors": vectors[:, :-1]},
        "not finite": {"names": names, "vectors": infinite},
        "zero": {"names": names, "vectors": vectors * (np.arange(4) != 1)[:, None]},
        "texts": {"names": names, "vectors": vectors.astype("U8")},
        "too few": {"names": names[:-1], "vectors": vectors[:-1]},
    }
    if kind in arrays:
        return write_npz(path, arrays[kind], overwrite=True)
    place = content.index(vectors[2].tobytes())
    changed = content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]
    path.write_bytes({"empty": b"", "cut": content[:-100], "a bit": changed, "text": b"words"}[kind])
    return None


@pytest.mark.parametrize("kind", [
    "empty", "cut", "a bit", "text", "wrong names", "wrong dimension", "not finite", "zero", "texts", "too few",
])  # fmt: skip
def test_a_damaged_file_is_replaced(cache: Path, kind: str) -> None:
    expected, _ = ask()
    (path,) = cache.iterdir()
    written = path.read_bytes()
    damage(path, kind)
    vectors, calls = ask()
    assert (len(calls), path.read_bytes()) == (1, written)
    assert vectors.equal(expected)


@pytest.mark.parametrize("kind", ["file", "folder", "read-only", "homeless"])
def test_without_a_cache_words_are_encoded(
    tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    expected, _ = ask()
    (path,) = cache.iterdir()
    shutil.rmtree(cache)
    if kind == "file":
        cache.write_text("")
    elif kind == "folder":
        path.mkdir(parents=True)
    elif kind == "read-only":

        def refuse(*arguments: object, **options: object) -> None:
            raise PermissionError("read-only")

        monkeypatch.setattr(Path, "mkdir", refuse)
    else:
        monkeypatch.delenv("SCOUP_CACHE")
        monkeypatch.setattr("scoup.models.word_cache.cache_folder", lambda: None)
    for _ in range(2):
        vectors, calls = ask()
        assert len(calls) == 1
        assert vectors.equal(expected)


def test_vectors_that_are_not_finite_are_not_kept(cache: Path) -> None:
    vectors, calls = random_vectors(), []
    vectors[2] = torch.nan
    found = word_cache.everyday_vectors(MODEL, vectors[:1], NAMES, encoder_of(vectors, calls))
    assert found.isnan().any(1).tolist() == [False, True, False]
    assert not cache.exists()


def write_at_once(cache: str) -> list[list[float]]:
    os.environ["SCOUP_CACHE"] = cache
    found = []
    for _ in range(20):
        found.append(ask()[0].flatten().tolist())
        for path in Path(cache, "words").glob("a-model-*"):
            with suppress(PermissionError):  # Windows: the other process may just read it
                path.unlink(missing_ok=True)
    return found


def test_processes_that_write_at_once(cache: Path) -> None:
    expected = ask()[0].flatten().tolist()
    with workers(2) as pool:
        for found in pool.map(write_at_once, [str(cache.parent)] * 2):
            assert found == [expected] * 20
    ask()
    (path,) = cache.iterdir()  # and no temporary file
    assert load_table(path).names == (word_cache.PROBE, *NAMES)


def test_files_of_a_model(tmp_path: Path) -> None:
    assert file_states(str(tmp_path / "laion2b")) == ()
    (tmp_path / "weights").write_text("123")
    os.utime(tmp_path / "weights", ns=(0, 5))
    (tmp_path / "inner").mkdir()
    state = f"{os.path.realpath(tmp_path / 'weights')} 3 5"
    assert file_states(str(tmp_path)) == file_states(str(tmp_path / "weights")) == (state,)
