"""Vectors of everyday words are encoded once per model, and read from a cache that is never trusted."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from scoup.base import write_npz
from scoup.models import text, word_cache
from scoup.models.hub import ModelIdentity, file_states
from scoup.models.text import TextEncoder
from scoup.models.word_cache import PROBE, cache_folder
from scoup.models.word_table import WordTable
from scoup.models.words import EVERYDAY_WORDS
from support import unit
from tiny_models import save_text_clip

MODEL = ModelIdentity("a/model", "c0ffee", "package 1")
NAMES = ("apple", "chair", "kettle")


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("SCOUP_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache" / "words"


def test_a_model_encodes_words_once(tmp_path: Path, cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    counted: list[str] = []  # phrases, but for the one that every opening encodes
    open_model, folder = text.open_text_model, save_text_clip(tmp_path / "clip")

    def opened(*arguments: object) -> tuple[text.Encode, ModelIdentity]:
        encode, identity = open_model(*arguments)  # pyright: ignore[reportArgumentType]

        def encode_counted(batch: list[str]) -> Tensor:
            counted.extend(phrase for phrase in batch if phrase != PROBE)
            return encode(batch)

        return encode_counted, identity

    monkeypatch.setattr(text, "open_text_model", opened)
    first = TextEncoder.open(folder).everyday()
    assert counted == list(EVERYDAY_WORDS)
    torch.testing.assert_close(first.norm(dim=1), torch.ones(len(first)))
    (path,) = cache.iterdir()
    assert path.name.startswith("clip-")
    written = path.read_bytes()
    encoder = TextEncoder.open(folder)
    assert encoder.everyday().equal(first)
    assert encoder.encode(list(EVERYDAY_WORDS)).equal(first)  # as a page asks for its vocabulary
    assert len(counted) == len(EVERYDAY_WORDS)
    assert path.read_bytes() == written
    plain = encoder.encode(EVERYDAY_WORDS[:-1])  # not from the cache
    assert len(plain) == len(first) - 1 == len(counted) - len(first)
    torch.testing.assert_close(first[:-1], plain, atol=5e-4, rtol=0)
    # Other weights, even if all that the file system says is as before, which it rarely is.
    before = (folder / "model.safetensors").stat()
    save_text_clip(folder, seed=1)
    os.utime(folder / "model.safetensors", ns=(before.st_atime_ns, before.st_mtime_ns))
    counted.clear()
    assert not TextEncoder.open(folder).everyday().allclose(first, atol=0.01)
    assert counted == list(EVERYDAY_WORDS)


def random_vectors(seed: int = 0) -> Tensor:
    return unit(torch.randn(1 + len(NAMES), 16, generator=torch.Generator().manual_seed(seed)))


def ask(
    model: ModelIdentity = MODEL, words: Sequence[str] = NAMES, seed: int = 0, nan_row: int | None = None
) -> tuple[Tensor, list[int]]:
    """Vectors of words, and how many each call of the encoder was asked for."""
    vectors, calls = random_vectors(seed), []
    if nan_row is not None:
        vectors[nan_row] = torch.nan

    def encode(asked: Sequence[str]) -> Tensor:
        calls.append(len(asked))
        return vectors[1 : 1 + len(asked)]

    return word_cache.everyday_vectors(model, vectors[:1], words, encode), calls


def test_what_the_key_depends_on(cache: Path) -> None:
    ask()
    (path,) = cache.iterdir()
    assert path.name.startswith("a-model-c0ffee-")
    assert WordTable.load(path).names == (PROBE, *NAMES)
    others: list[tuple[ModelIdentity, Sequence[str], int]] = [
        (replace(MODEL, name="a/another"), NAMES, 0), (replace(MODEL, revision="0ff"), NAMES, 0),
        (replace(MODEL, package="package 2"), NAMES, 0), (replace(MODEL, files=("weights 3 4",)), NAMES, 0),
        (MODEL, NAMES[:2], 0), (MODEL, NAMES, 1),  # other weights, of which nothing but the probe tells
    ]  # fmt: skip
    for model, words, seed in others:
        for calls in ([len(words)], []):
            assert ask(model, words, seed)[1] == calls


def damaged(content: bytes) -> dict[str, bytes | dict[str, np.ndarray]]:
    """Contents, or the arrays of a table."""
    names, vectors = np.array([PROBE, *NAMES]), random_vectors().half().numpy()
    infinite = vectors.copy()
    infinite[2, 3] = np.inf
    place = content.index(vectors[2].tobytes())
    return {
        "empty": b"", "cut": content[:-100], "text": b"words",
        "a bit": content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :],
        "wrong names": {"names": names[::-1], "vectors": vectors},
        "wrong dimension": {"names": names, "vectors": vectors[:, :-1]},
        "not finite": {"names": names, "vectors": infinite},
        "zero": {"names": names, "vectors": vectors * (np.arange(4) != 1)[:, None]},
        "texts": {"names": names, "vectors": vectors.astype("U8")},
        "too few": {"names": names[:-1], "vectors": vectors[:-1]},
    }  # fmt: skip


def test_a_damaged_file_is_replaced(cache: Path) -> None:
    expected, _ = ask()
    (path,) = cache.iterdir()
    written = path.read_bytes()
    for kind, content in damaged(written).items():
        path.write_bytes(content) if isinstance(content, bytes) else write_npz(path, content, overwrite=True)
        vectors, calls = ask()
        assert (len(calls), path.read_bytes()) == (1, written), kind
        assert vectors.equal(expected)


@pytest.mark.parametrize("kind", ["file", "folder", "read-only", "homeless"])
def test_without_a_cache_words_are_encoded(cache: Path, monkeypatch: pytest.MonkeyPatch, kind: str) -> None:
    expected, _ = ask()
    (path,) = cache.iterdir()
    shutil.rmtree(cache)
    if kind == "file":
        cache.write_text("")
    elif kind == "folder":
        path.mkdir(parents=True)
    elif kind == "read-only":
        monkeypatch.setattr(Path, "mkdir", refusing(PermissionError("read-only")))
    else:
        monkeypatch.setattr(word_cache, "cache_folder", lambda: None)
    for _ in range(2):
        vectors, calls = ask()
        assert len(calls) == 1
        assert vectors.equal(expected)


def refusing(error: Exception) -> Callable[..., Path]:
    def refuse(*arguments: object, **options: object) -> Path:
        raise error

    return refuse


def test_vectors_that_are_not_finite_are_not_kept(cache: Path) -> None:
    assert ask(nan_row=2)[0].isnan().any(1).tolist() == [False, True, False]
    assert not cache.exists()


def test_files_of_a_model(tmp_path: Path) -> None:
    assert file_states(str(tmp_path / "laion2b")) == ()
    (tmp_path / "weights").write_text("123")
    os.utime(tmp_path / "weights", ns=(0, 5))
    (tmp_path / "inner").mkdir()
    state = f"{os.path.realpath(tmp_path / 'weights')} 3 5"
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
    home = refusing(RuntimeError("no home")) if variables is None else lambda: Path("home")
    monkeypatch.setattr(Path, "home", home)
    assert cache_folder() == (None if expected is None else Path(expected))
