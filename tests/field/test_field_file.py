"""The ``.scoup`` file: its versions, its checksums, and what becomes of damage."""

from __future__ import annotations

import json
import pickle
import struct
import zlib
from pathlib import Path

import pytest
import torch
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from field.conftest import field_with_things
from field_files import parts_of, tensor_checksum, write_parts
from messages import refuses
from scoup.base import FileFormatError
from scoup.base.errors import FieldVersionError
from scoup.field.container import VERSION
from scoup.query import LanguageField
from support import examples


def check_same(one: LanguageField, other: LanguageField) -> None:
    """Equal in everything that is stored."""
    for name in ("code_indices", "code_weights", "codebook"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
        assert getattr(one, name).dtype == getattr(other, name).dtype
    assert one.info == other.info
    for name, part in vars(other.thing_table).items():
        mine = getattr(one.thing_table, name)
        assert mine.equal(part) if isinstance(part, torch.Tensor) else mine.texts == part.texts, name
    assert one.gaussians.fingerprint() == other.gaussians.fingerprint()
    assert torch.equal(one.gaussians.sh, other.gaussians.sh)
    cameras = [
        [(camera.name, camera.fingerprint()) for camera in each.cameras or ()] for each in (one, other)
    ]
    assert cameras[0] == cameras[1] != []


def test_the_version_is_read(whole: Path) -> None:
    assert parts_of(whole)[0]["version"] == VERSION == 1
    check_same(LanguageField.load(whole), field_with_things())


def test_what_the_checksums_are_of(whole: Path) -> None:
    """As docs/formats.md says, so that others can check and write them."""
    header, tensors = parts_of(whole)
    assert header["checksums"].keys() == tensors.keys()
    described = b"float32 [3, 4, 8]\n" + tensors["codebook"].numpy().tobytes()
    assert header["checksums"]["codebook"] == f"{zlib.crc32(described):08x}"
    text = json.dumps({**header, "checksum": "00000000"}, sort_keys=True)
    assert header["checksum"] == f"{zlib.crc32(text.encode()):08x}"
    numbers = torch.arange(6, dtype=torch.float32)
    shapes = (numbers, numbers.reshape(2, 3), numbers.reshape(3, 2), numbers.view(torch.int32))
    assert len({tensor_checksum(each) for each in shapes}) == 4
    turned = numbers.reshape(2, 3).T
    assert tensor_checksum(turned) == tensor_checksum(turned.contiguous())
    for kind in (torch.uint8, torch.uint16, torch.float16, torch.float64, torch.int32):
        assert len(tensor_checksum(torch.zeros(0, 3, dtype=kind))) == 8


@pytest.mark.parametrize("version", [7, 0, -1, True, "2", 2.0, None, [2]])
def test_a_newer_version_is_an_error_of_its_own(whole: Path, tmp_path: Path, version: object) -> None:
    header, tensors = parts_of(whole)
    write_parts(tmp_path / "f.scoup", {**header, "version": version}, tensors)
    with refuses(FileFormatError) as caught:
        LanguageField.load(tmp_path / "f.scoup")
    assert isinstance(caught.value, FieldVersionError) == (version == 7)
    if isinstance(caught.value, FieldVersionError):
        assert (caught.value.version, caught.value.newest) == (7, VERSION)
        assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_the_codebook_begins_where_torch_would_put_it(whole: Path, tmp_path: Path) -> None:
    # Libraries sum the products of matrices in another order where the memory begins elsewhere: whatever the file's
    # header holds, a field must answer with the same bytes.
    field = LanguageField.load(whole)
    for length in range(8, 72, 8):
        field.geometry_path = tmp_path / ("p" * length)
        field.save(tmp_path / f"{length}.scoup")
        assert LanguageField.load(tmp_path / f"{length}.scoup").codebook.data_ptr() % 64 == 0


def test_what_is_damaged_is_named(whole: Path, tmp_path: Path) -> None:
    header, tensors = parts_of(whole)
    damaged = [({**header, "embedding_model": "another/model"}, tensors)]
    damaged += [(header, {**tensors, "more": torch.zeros(2)})]
    damaged += [({name: value for name, value in header.items() if name != "checksum"}, tensors)]
    for name, tensor in tensors.items():
        changed = tensor.clone()
        changed.view(torch.uint8).view(-1)[0] ^= 1
        damaged += [(header, {**tensors, name: changed})]
    for parts in damaged:
        write_parts(tmp_path / "f.scoup", *parts)
        with refuses(FileFormatError):
            LanguageField.load(tmp_path / "f.scoup")


def check_flipped(whole: Path, content: bytes, bit: int, target: Path) -> None:
    """One bit flipped: an error that names the file, or, where it changes nothing, the same field."""
    damaged = bytearray(content)
    damaged[bit // 8] ^= 1 << bit % 8
    target.write_bytes(damaged)
    try:
        found = LanguageField.load(target)
    except FileFormatError as error:
        message = str(error)
    else:
        check_same(found, LanguageField.load(whole))
        message = target.name
    assert target.name in message


@settings(
    max_examples=examples(300), suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None
)
@given(place=st.floats(0, 1, exclude_max=True), in_header=st.booleans())
@example(place=0.0, in_header=True)
def test_any_flipped_bit_is_found(whole: Path, tmp_path: Path, place: float, in_header: bool) -> None:
    content = whole.read_bytes()
    length = 8 + struct.unpack("<Q", content[:8])[0] if in_header else len(content)
    check_flipped(whole, content, int(place * length * 8), tmp_path / "damaged.scoup")


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_every_flipped_bit_is_found(whole: Path, tmp_path: Path) -> None:
    content = whole.read_bytes()
    for bit in range(8 * len(content)):
        check_flipped(whole, content, bit, tmp_path / "damaged.scoup")
