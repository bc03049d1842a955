"""Everyday words, word tables of every form, whole and damaged, and the text encoder over them."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file
from torch import Tensor

from children import finished
from messages import refuses
from scoup.base import FileFormatError, MissingFileError, OutputExistsError, UnknownNameError
from scoup.models.text import TextEncoder
from scoup.models.word_table import WordTable
from scoup.models.words import CANONICAL_PHRASES, EVERYDAY_WORDS, LEAST_WORDS, with_everyday
from support import unit

NAMES = ["apple", "Dark Cup", "chair"]
VECTORS = np.array([[3.0, 0, 4], [0, 2, 0], [1, 1, 1]], dtype=np.float32)
UNIT = torch.nn.functional.normalize(torch.from_numpy(VECTORS), dim=1)


def write_table(path: Path, form: str) -> Path:
    vectors, by_name = torch.from_numpy(VECTORS), dict(zip(NAMES, VECTORS, strict=True))
    if form == "npz-pair":
        np.savez(path, names=np.array(NAMES), vectors=VECTORS)
    elif form == "npz-compressed":
        np.savez_compressed(path, names=np.array(NAMES), vectors=VECTORS.astype(">f8"))
    elif form == "npz-names":
        np.savez(path, **by_name)
    elif form == "json":
        path.write_text(json.dumps({name: row.tolist() for name, row in by_name.items()}))
    elif form == "safetensors-pair":
        save_file({"vectors": vectors.half()}, path, metadata={"names": json.dumps(NAMES)})
    else:
        save_file({name: torch.from_numpy(row) for name, row in by_name.items()}, path)
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
        torch.testing.assert_close(encoder.encode(["the Dark Cups"]), UNIT[[1]])
        assert encoder.encode([]).shape == (0, 3)
    with refuses():
        encoder.encode(["apple"])


def test_exact_case_goes_before_folded(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    path.write_text(json.dumps({"Apple": [1, 0], "apple": [0, 1]}))
    encoder = TextEncoder.open(path)
    assert encoder.encode(["apple", "Apple", "APPLE"]).tolist() == [[0, 1], [1, 0], [1, 0]]


def test_missing_word_lists_the_nearest_names_and_the_file(tmp_path: Path) -> None:
    encoder = TextEncoder.open(write_table(tmp_path / "words.npz", "npz-pair"))
    with refuses(UnknownNameError):
        encoder.encode(["chair", "appel"])
    for phrases in ("apple", [" "], [NAMES[0], "ab" * 1_000_000]):  # long texts are not repeated
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
    for names, vectors in (
        (["a"], [[0.0, 0.0]]),
        (["a", "b"], [[1.0]]),
        (["a", "a"], [[1.0], [1.0]]),
        ([], []),
    ):
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
    header = "{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387904, 8), }"
    header = header.ljust(117) + "\n"
    member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode()
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("vectors.npy", member)
        archive.writestr("names.npy", member)
    with refuses(FileFormatError):
        WordTable.load(path)


def test_everyday_words_of_a_table_are_its_other_names(tmp_path: Path) -> None:
    names = ["red apple", "Object", "chair", "things", "stuff", "texture"]
    vectors = np.random.default_rng(0).normal(size=(6, 5)).astype(np.float32)
    WordTable.save(tmp_path / "words.npz", names, vectors)
    encoder = TextEncoder.open(tmp_path / "words.npz")
    assert encoder.names == tuple(names)
    assert torch.equal(encoder.everyday(), encoder.encode(["red apple", "chair"]))
    assert torch.equal(encoder.canonical(), encoder.encode(["object", "things", "stuff", "texture"]))
    assert torch.equal(encoder.canonical(everyday=True), encoder.canonical())  # two words are too few


def test_a_dict_is_an_encoder() -> None:
    vectors = torch.randn(5, 6, generator=torch.Generator().manual_seed(0))
    names = ["object", "things", "stuff", "texture", "red apple"]
    expected = torch.nn.functional.normalize(vectors, dim=1)
    for rows in (vectors, 7 * vectors.double().numpy(), vectors.tolist()):
        encoder = TextEncoder.open(dict(zip(names, rows, strict=True)))
        assert (encoder.names, encoder.dim, encoder.name) == (tuple(names), 6, "")
        torch.testing.assert_close(encoder.encode(["Red Apple", "stuff"]), expected[[4, 2]])
    with refuses(UnknownNameError):
        encoder.encode(["red aple"])
    encoder.close()
    with refuses():
        encoder.canonical()


def test_dicts_that_are_no_table() -> None:
    ones, table = torch.ones(3), {"a": torch.ones(3), "b": torch.ones(4)}
    for vectors in ({}, table, {"a": torch.ones(2, 2)}, {"a": 0 * ones}, {"a": torch.nan * ones}, {3: ones}):
        with refuses():
            TextEncoder.open(vectors)  # pyright: ignore[reportArgumentType]


def test_archives_that_unpack_to_no_end_are_refused(tmp_path: Path) -> None:
    for length in (1000, 3_000_000):
        vectors = np.ones((2, length), np.float32)
        np.savez_compressed(tmp_path / f"{length}.npz", names=np.array(["a", "b"]), vectors=vectors)
    assert WordTable.load(tmp_path / "1000.npz").vectors.shape == (2, 1000)
    with refuses(FileFormatError):
        WordTable.load(tmp_path / "3000000.npz")


def test_canonical_phrases_are_the_papers() -> None:
    assert CANONICAL_PHRASES == ("object", "things", "stuff", "texture")


def test_the_list_is_read_when_it_is_needed(preloaded_python: str) -> None:
    program = (
        "import scoup.models.text, scoup.models.words as words; assert 'EVERYDAY_WORDS' not in vars(words); "
        "assert words.EVERYDAY_WORDS is words.EVERYDAY_WORDS; assert not hasattr(words, 'OTHER_WORDS')"
    )
    finished([preloaded_python, "-c", program], check=True)


def random(*shape: int, seed: int = 0) -> Tensor:
    return unit(torch.randn(*shape, generator=torch.Generator().manual_seed(seed)))


def test_everyday_words() -> None:
    assert 950 <= len({word.casefold() for word in EVERYDAY_WORDS}) == len(EVERYDAY_WORDS) <= 1100
    assert not set(EVERYDAY_WORDS) & set(CANONICAL_PHRASES)
    for word in EVERYDAY_WORDS:
        assert word == " ".join(word.split())
        assert 1 <= len(word.split()) <= 2, word
    canonical, words = random(4, 16), random(LEAST_WORDS, 16, seed=1)
    both = with_everyday(canonical, words)
    assert torch.equal(both[:4], canonical)
    assert torch.allclose(both[4], words.mean(0))
    assert with_everyday(canonical, words[1:]) is canonical
