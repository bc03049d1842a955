"""The field and its file: versions, checksums, and what becomes of damage."""

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
from safetensors.torch import save_file

import scoup
from field.conftest import field_with_things
from field_files import check_same_things, parts_of, tensor_checksum, write_parts
from messages import refuses
from scoup.base import FileFormatError, OutputExistsError
from scoup.base.errors import FieldVersionError
from scoup.field.container import VERSION
from scoup.field.field import GeometryMismatchError
from scoup.field.field_info import FieldInfo
from scoup.query import LanguageField, build
from scoup.scene import index_dtype
from scoup.uplift import BuildSettings, FieldSources
from support import examples, random_gaussians, small_scene, unit
from uplift.edits import joined

QUICK = BuildSettings(n_atoms=8, k=3, keep=3, rounds=1, solver="adam", epochs=20)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def field(scene) -> LanguageField:
    return build(*scene, settings=QUICK, sources=FieldSources("a/model"))


def test_unpainted_gaussians_have_empty_codes_and_render_as_nothing(scene):
    gaussians, cameras, regions = scene
    hidden = random_gaussians(5, 1, ("behind",))
    hidden.means[:, 2] -= 50
    field = build(joined(gaussians, hidden), cameras, regions, settings=QUICK)
    assert not field.coded()[-5:].any()
    relevancy = field.gaussian_relevancy(unit(torch.randn(2, 16)), unit(torch.randn(3, 16)))
    assert (relevancy[:, :, -5:] == 0.5).all()
    assert field.render_codes(cameras[0]).shape == (3, 30, 40, 8)


@pytest.mark.parametrize("n_atoms", [8, 300])
def test_relevancy_equals_decoding_to_d_dimensions(scene, tmp_path, n_atoms):
    gaussians, cameras, regions = scene
    field = build(gaussians, cameras, regions, settings=BuildSettings(n_atoms=n_atoms, rounds=1))
    assert field.code_indices.dtype == index_dtype(n_atoms)
    field.save(tmp_path / "f.scoup")
    back = LanguageField.load(tmp_path / "f.scoup", gaussians)
    queries, canonical = unit(torch.randn(3, 16)), unit(torch.randn(4, 16))
    actual = back.relevancy(cameras[0], queries, canonical)
    own = back.gaussian_relevancy(queries, canonical)
    for s, level in enumerate(back.levels):
        rendered, decoded = back.render_features(cameras[0], level), back.gaussian_features(level)
        for found, features in ((actual[s].permute(1, 2, 0), rendered), (own[s].T, decoded)):
            best = (features @ canonical.T).amax(-1, keepdim=True)
            assert torch.allclose(found, torch.sigmoid(10 * (features @ queries.T - best)), atol=1e-4)


def test_eight_bits_are_close_and_take_no_code_away(field, tmp_path):
    even = torch.full((len(field), len(field.levels), 4), 1 / 600)
    indices = torch.zeros(even.shape, dtype=torch.uint16)
    many = LanguageField(indices, even, field.codebook.repeat(1, 75, 1), field.info)
    many.save(tmp_path / "many.scoup", weight_bits=8)
    assert LanguageField.load(tmp_path / "many.scoup").coded().all()
    field.save(tmp_path / "f.scoup", weight_bits=8)
    back = LanguageField.load(tmp_path / "f.scoup")
    assert (back.code_weights.float() - field.code_weights.float()).abs().max() <= 1.5 / 255
    with refuses():
        field.save(tmp_path / "g.scoup", weight_bits=4)


@pytest.fixture
def beside(field, tmp_path) -> LanguageField:
    """A field whose splat is in a file of its own."""
    splat = tmp_path / "scene" / "splat.ply"
    scoup.save_gaussians(field.gaussians, splat)
    made = field.with_gaussians(scoup.load_gaussians(splat))
    made.geometry_path = splat
    return made


def test_geometry_is_found_by_relative_path_and_checked(beside, tmp_path):
    beside.save(tmp_path / "scene" / "f.scoup")
    path = (tmp_path / "scene").rename(tmp_path / "moved") / "f.scoup"
    assert len(LanguageField.load(path).gaussians) == len(beside)
    with refuses(GeometryMismatchError):
        LanguageField.load(path, random_gaussians(len(beside), 77))
    path.with_name("splat.ply").unlink()
    with refuses(FileFormatError):
        _ = LanguageField.load(path).gaussians
    assert LanguageField.load(path, beside.gaussians).gaussians is beside.gaussians


def test_links_to_a_field_lead_to_what_it_names(beside, tmp_path):
    field, splat = beside, beside.geometry_path
    (tmp_path / "store" / "deep").mkdir(parents=True)
    (tmp_path / "linked").symlink_to(tmp_path / "store" / "deep")
    for folder in ("store/deep", "linked"):
        path = tmp_path / folder / "f.scoup"
        field.save(path, overwrite=True)
        link = tmp_path / "link.scoup"
        link.unlink(missing_ok=True)
        link.symlink_to(path)
        for name in (tmp_path / "linked" / "f.scoup", tmp_path / "store" / "deep" / "f.scoup", link):
            assert LanguageField.load(name).geometry_path == splat, (folder, name)
    field.geometry_path = tmp_path / "linked" / "splat.ply"  # beside the field, so it moves with it
    field.save(tmp_path / "linked" / "g.scoup")
    (tmp_path / "store").rename(tmp_path / "moved")
    moved = tmp_path / "moved" / "deep"
    assert LanguageField.load(moved / "g.scoup").geometry_path == moved / "splat.ply"


def test_nothing_is_overwritten_unless_wanted(field, tmp_path):
    path = tmp_path / "f.scoup"
    path.write_bytes(b"precious")
    with refuses(OutputExistsError):
        field.save(path)
    assert path.read_bytes() == b"precious"
    field.save(path, overwrite=True)
    assert len(LanguageField.load(path)) == len(field)


def test_parts_that_do_not_fit_are_refused(field):
    info, (indices, weights, codebook) = field.info, field.parts()[:3]
    for parts in (
        (indices[:, :2], weights, codebook, info),
        (indices, weights[..., :1], codebook, info),
        (indices, weights, codebook[:2], info),
        (indices, weights, codebook.bfloat16(), info),
        (indices.clone().fill_(8), weights, codebook, info),
        (indices, -weights, codebook, info),
        (indices, weights, codebook * torch.nan, info),
        (indices, weights, codebook, FieldInfo(info.levels, "", info.fingerprint, 3)),
    ):
        with refuses():
            LanguageField(*parts)


def test_other_files_are_named_for_what_they_are(tmp_path):
    with refuses(FileFormatError):
        LanguageField.load(tmp_path / "x.scoup")
    save_file({"a": torch.zeros(3)}, tmp_path / "x.scoup")
    with refuses(FileFormatError):
        LanguageField.load(tmp_path / "x.scoup")


def check_same(one: LanguageField, other: LanguageField) -> None:
    """Equal in everything that is stored."""
    for name in ("code_indices", "code_weights", "codebook"):
        assert torch.equal(getattr(one, name), getattr(other, name)), name
        assert getattr(one, name).dtype == getattr(other, name).dtype
    assert one.info == other.info
    check_same_things(one.thing_table, other.thing_table)
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
